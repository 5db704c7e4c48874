// The measuring line between two aircraft or points: distance, bearing and time of flight.

/** An end of the line is `{ callsign }`, which moves with the aircraft, or `{ point }`. */
class Measure {
  constructor() {
    this.ends = null;
  }

  from(end) {
    this.ends = [end, end];
  }

  to(end) {
    this.ends = [this.ends[0], end];
  }

  clear() {
    this.ends = null;
  }

  /** The line on one radar, or null: the positions of its ends, and its values. */
  on(plane, flying, selected, row, part) {
    if (!this.ends) return null;
    const aircraft = this.ends.map((end) => flying.find((each) => each.callsign === end.callsign));
    const [from, to] = this.ends.map((end, index) =>
      aircraft[index] ? positionOf(aircraft[index], row, part) : end.point,
    );
    if (!from || !to || Math.hypot(to[0] - from[0], to[1] - from[1]) < 1e-6) return null;
    const other = flying.find((each) => each.callsign === selected);
    const flies = aircraft[0] ?? aircraft[1] ?? other;
    const speedKt = flies ? flies.speedKt[row] : 0;
    const names = aircraft.map((each) => each?.callsign ?? "point");
    return { from, to, names, flies, speedKt, ...measured(plane, from, to, speedKt) };
  }
}

/** The length of the line of constant heading, that heading, and the time to fly it. */
function measured(plane, from, to, speedKt) {
  const nm = plane.lengthNm(from, to);
  const degrees = (Math.atan2(to[0] - from[0], to[1] - from[1]) * 180) / Math.PI;
  return { nm, degrees: (degrees + 360) % 360, seconds: speedKt > 0 ? (nm / speedKt) * 3600 : null };
}

function measureText({ nm, degrees, seconds }) {
  const time = seconds === null ? "" : ` ${minutes(seconds)}`;
  return `${nm.toFixed(1)} NM ${threeDigits(degrees)}°${time}`;
}

/** The same in words, with the ends, and the aircraft whose ground speed applies. */
function measureWords(line) {
  const { names, nm, degrees, seconds, flies, speedKt } = line;
  const at = seconds === null ? "" : `, ${minutes(seconds)} at ${Math.round(speedKt)} kt`;
  const whose = seconds === null || names.includes(flies.callsign) ? "" : ` (${flies.callsign})`;
  const bearing = `bearing ${threeDigits(degrees)}°`;
  return `${names.join(" to ")}: ${nm.toFixed(1)} NM, ${bearing}${at}${whose}`;
}

function drawMeasure(pen, line) {
  const [from, to] = [line.from, line.to].map((position) => pen.at(...position));
  const colour = pen.colour.ink;
  stroke(pen, [from, to], colour, { width: 1.5, dash: [10, 3, 2, 3] });
  for (const [x, y] of [from, to]) {
    stroke(pen, [[x - 5, y], [x + 5, y]], colour);
    stroke(pen, [[x, y - 5], [x, y + 5]], colour);
  }
  const toLeft = to[0] > pen.width - 170;
  const y = Math.min(Math.max(to[1] - 14, 10), pen.height - 10);
  const align = toLeft ? "right" : "left";
  write(pen, measureText(line), to[0] + (toLeft ? -10 : 10), y, colour, { align, bold: true });
}
