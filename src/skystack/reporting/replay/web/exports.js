// Downloads made in the page: the picture as PNG, the clearances as CSV. Nothing is sent.

const CSV_COLUMNS = [
  ...["run", "scenario", "cycle", "time_s", "callsign"],
  ...["kind", "value", "direction", "instructions", "text"],
];
const FORMULA = /^[=+\-@\t\r]/; // what spreadsheets would run

function csvCell(value) {
  const text = String(value ?? "");
  const plain = typeof value === "string" && FORMULA.test(text) ? `'${text}` : text;
  return /[",\r\n]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
}

/** The clearances of a scenario in all runs, with the cycles of the tables (RFC 4180). */
function csvOf(titles, number, runs, cycleS) {
  const rows = runs.flatMap((run, index) =>
    run.clearances.map((each) => [
      ...[titles[index], number, each.cycle, each.cycle * cycleS, each.callsign],
      ...[each.kind, each.value, each.direction, each.instructions, each.text],
    ]),
  );
  return [CSV_COLUMNS, ...rows].map((row) => `${row.map(csvCell).join(",")}\r\n`).join("");
}

/** The radars side by side on one canvas, each below its `heading`. */
function pictureOf(canvases, headings) {
  const ratio = window.devicePixelRatio || 1;
  const made = document.createElement("canvas");
  const line = Math.round(30 * ratio);
  made.width = canvases.reduce((sum, each) => sum + each.width, 0);
  made.height = Math.max(...canvases.map((each) => each.height)) + line;
  const g = made.getContext("2d");
  const style = getComputedStyle(document.documentElement);
  g.fillStyle = style.getPropertyValue("--radar").trim();
  g.fillRect(0, 0, made.width, made.height);
  g.font = `600 ${14 * ratio}px ${MONO}`;
  g.textBaseline = "middle";
  let left = 0;
  canvases.forEach((canvas, index) => {
    g.fillStyle = style.getPropertyValue("--ink").trim();
    g.fillText(headings[index], left + 10 * ratio, line / 2, canvas.width - 20 * ratio);
    g.drawImage(canvas, left, line);
    left += canvas.width;
  });
  return made;
}

function download(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
