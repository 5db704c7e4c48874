// The vertical profile of the selected aircraft: its levels over time.

const PROFILE_MARGIN = { left: 34, right: 12, top: 8, bottom: 18 };
const PROFILE_STEPS_FL = [5, 10, 20, 50, 100, 200];

class Profile {
  constructor(pane, player) {
    this.player = player;
    this.section = pane.querySelector(".profile");
    this.canvas = this.section.querySelector("canvas");
    this.caption = this.section.querySelector("h3");
    const goTo = (event) => {
      if (event.type === "pointermove" && !event.buttons) return;
      const { left, right } = PROFILE_MARGIN;
      const part = (event.offsetX - left) / (this.canvas.clientWidth - left - right);
      player.play(false);
      player.goTo(Math.round(part * player.lastRow));
    };
    this.canvas.addEventListener("pointerdown", goTo);
    this.canvas.addEventListener("pointermove", goTo);
  }

  /** The aircraft whose levels are drawn: the selected ones, or the only one. */
  aircraftOf(scenario) {
    const { player } = this;
    if (scenario.aircraft.length === 1) return scenario.aircraft;
    const named = [player.selected, player.partner];
    const found = named.map((name) => scenario.aircraft.find((each) => each.callsign === name));
    return found.filter(Boolean);
  }

  show(scenario, row, isOn) {
    this.section.hidden = !isOn;
    if (!isOn) return;
    const [aircraft] = this.aircraftOf(scenario);
    const text = aircraft ? profileText(aircraft, row) : "select an aircraft";
    this.caption.textContent = `Vertical profile: ${text}`;
    this.canvas.setAttribute("aria-label", this.caption.textContent);
  }

  draw(scenario, row) {
    if (this.section.hidden) return;
    const pen = inkOf(this.canvas);
    pen.g.fillStyle = pen.colour.radar;
    pen.g.fillRect(0, 0, pen.width, pen.height);
    const [aircraft, partner] = this.aircraftOf(scenario);
    if (!aircraft) return;
    const axes = profileAxes(pen, [aircraft, ...(partner ? [partner] : [])], this.player.lastRow);
    drawProfileGrid(pen, axes, this.player);
    if (partner) drawLevels(pen, axes, partner, pen.colour.aircraft);
    drawPlannedLevels(pen, axes, aircraft);
    drawLevels(pen, axes, aircraft, pen.colour.selected);
    const x = axes.x(row);
    stroke(pen, [[x, axes.top], [x, axes.bottom]], pen.colour.ink, { width: 1.5 });
  }
}

function profileText(aircraft, row) {
  const last = Math.min(Math.max(row, aircraft.begins), aircraft.rows - 1);
  const level = (fl) => `FL${String(Math.round(fl)).padStart(3, "0")}`;
  const now = `${level(aircraft.fl[last])}, cleared ${level(aircraft.clearedFl[last])}`;
  return `${aircraft.callsign} ${now}, in ${level(aircraft.entryFl)}, out ${level(aircraft.exitFl)}`;
}

function profileAxes(pen, aircraft, lastRow) {
  const levels = aircraft.flatMap((each) => [
    ...each.fl.subarray(each.begins),
    ...each.clearedFl.subarray(each.begins),
    each.entryFl,
    each.exitFl,
  ]);
  const low = levels.reduce((least, each) => Math.min(least, each)) - 5;
  const high = levels.reduce((most, each) => Math.max(most, each)) + 5;
  const { left, right, top, bottom } = PROFILE_MARGIN;
  const [width, height] = [pen.width - left - right, pen.height - top - bottom];
  return {
    ...{ low, high, left, right: left + width, top, bottom: top + height },
    x: (row) => left + (width * row) / Math.max(lastRow, 1),
    y: (fl) => top + (height * (high - fl)) / (high - low),
  };
}

function drawProfileGrid(pen, axes, { lastRow, replay }) {
  const { low, high } = axes;
  const rows = Math.max(Math.floor((axes.bottom - axes.top) / 22), 1);
  const step = PROFILE_STEPS_FL.find((each) => (high - low) / each <= rows) ?? 500;
  for (let fl = Math.ceil(low / step) * step; fl <= high; fl += step) {
    stroke(pen, [[axes.left, axes.y(fl)], [axes.right, axes.y(fl)]], pen.colour.airway, { width: 0.6 });
    const text = String(fl).padStart(3, "0");
    write(pen, text, axes.left - 5, axes.y(fl), pen.colour.muted, { align: "right", size: 11 });
  }
  const ends = [[0, "left"], [lastRow, "right"]];
  for (const [row, align] of ends) {
    const text = minutes(row * replay.cycle_s);
    write(pen, text, axes.x(row), axes.bottom + 10, pen.colour.muted, { align, size: 11 });
  }
}

/** Flown levels as a solid line, cleared levels as a dashed one. */
function drawLevels(pen, axes, aircraft, colour) {
  const rows = Array.from(aircraft.fl.keys()).slice(aircraft.begins);
  const flown = rows.map((row) => [axes.x(row), axes.y(aircraft.fl[row])]);
  const cleared = rows.flatMap((row) => {
    const fl = aircraft.clearedFl[row];
    const before = row > aircraft.begins ? aircraft.clearedFl[row - 1] : fl;
    const at = [axes.x(row), axes.y(fl)];
    return before === fl ? [at] : [[axes.x(row), axes.y(before)], at];
  });
  stroke(pen, cleared, colour, { width: 1.2, dash: [4, 4] });
  stroke(pen, flown, colour, { width: 2 });
}

/** Triangles at the entry level on the left and the exit level on the right, pointing inwards. */
function drawPlannedLevels(pen, axes, { entryFl, exitFl }) {
  const { g } = pen;
  for (const [x, fl, side] of [[axes.left, entryFl, 1], [axes.right, exitFl, -1]]) {
    const y = axes.y(fl);
    g.beginPath();
    for (const point of [[x + 7 * side, y], [x, y - 5], [x, y + 5]]) g.lineTo(...point);
    g.closePath();
    g.fillStyle = pen.colour.ink;
    g.fill();
  }
}
