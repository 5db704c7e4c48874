// The scrubber, and the marks of clearances and losses of separation above it, one lane per run.

const SVG = "http://www.w3.org/2000/svg";

function mark(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  return made;
}

class Timeline {
  constructor(player) {
    this.player = player;
    this.marks = document.getElementById("marks");
    this.scrubber = document.getElementById("scrubber");
    this.clock = document.getElementById("clock");
    this.scrubber.addEventListener("input", () => {
      player.play(false);
      player.goTo(this.scrubber.valueAsNumber);
    });
    this.marks.addEventListener("pointerdown", (event) => {
      const box = this.marks.getBoundingClientRect();
      player.play(false);
      player.goTo(Math.round(((event.clientX - box.left) / box.width) * player.length));
    });
  }

  open() {
    const { runs, length } = this.player;
    this.marks.setAttribute("viewBox", `0 0 ${length} ${runs.length}`);
    this.marks.style.height = `${12 + 14 * runs.length}px`;
    this.marks.replaceChildren(...runs.flatMap(laneOf));
  }

  /** Marks rows in which a loss is predicted: a dashed line at the top of the lane. */
  addConflict(lane, [begins, ends]) {
    const y = lane + 0.05;
    this.marks.append(mark("line", { class: "conflict", x1: begins, x2: ends, y1: y, y2: y }));
  }

  show() {
    const { row, length, replay } = this.player;
    const time = minutes(row * replay.cycle_s);
    this.scrubber.max = String(length);
    this.scrubber.value = String(row);
    this.scrubber.setAttribute("aria-valuetext", `${time}, cycle ${row} of ${length}`);
    this.clock.replaceChildren(element("strong", "", time), ` cycle ${row} of ${length}`);
  }
}

/** Losses as bars with a cross; clearances as lines, which are longer the more instructions they contain. */
function laneOf(run, lane) {
  const losses = run.losses.flatMap((loss) => {
    const [x, width] = [loss.begins, loss.ends - loss.begins];
    const [y1, y2] = [lane + 0.15, lane + 0.95];
    return [
      mark("rect", { class: "loss", x, y: y1, width, height: y2 - y1 }),
      mark("line", { class: "cross", x1: x, x2: x + width, y1, y2 }),
      mark("line", { class: "cross", x1: x, x2: x + width, y1: y2, y2: y1 }),
    ];
  });
  const issued = run.clearances.map(({ row, instructions }) => {
    const height = Math.min(0.35 + 0.1 * (instructions - 1), 0.8);
    const [y1, y2] = [lane + 0.95 - height, lane + 0.95];
    return mark("line", { class: "clearance", x1: row, x2: row, y1, y2 });
  });
  return [...losses, ...issued];
}
