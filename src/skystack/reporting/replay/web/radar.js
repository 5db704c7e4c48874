// The radar picture on a canvas, one function per layer.

const MONO = "ui-monospace, SFMono-Regular, Menlo, Consolas, 'DejaVu Sans Mono', monospace";
const COLOURS = [
  ...["ink", "radar", "area", "area-line", "airway", "fix", "muted"],
  ...["aircraft", "waiting", "selected", "conflict", "loss"],
];

/** The context of a canvas of the size on the page, that size, and the colours of the theme. */
function inkOf(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const pixels = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) {
    [canvas.width, canvas.height] = pixels;
  }
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  const style = getComputedStyle(document.documentElement);
  const colour = Object.fromEntries(
    COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]),
  );
  return { g, width, height, colour };
}

/** The drawing tools of the layers: those of `inkOf`, and functions for positions in pixels and for
 *  pixels per true NM at a plane distance north of the origin. */
function penOf(canvas, view, plane) {
  const ink = inkOf(canvas);
  const { width, height } = ink;
  const [at, planeNm] = [view.toPixels(width, height), view.pixelsPerNm(width, height)];
  const nm = (y) => planeNm * plane.scale(y);
  const seen = [-0.5, 0, 0.5].map((part) => view.centre[1] + (part * height) / planeNm);
  return { ...ink, at, nm, plane, seen };
}

function stroke(pen, points, colour, { width = 1, dash = [], close = false } = {}) {
  const { g } = pen;
  g.beginPath();
  for (const [x, y] of points) g.lineTo(x, y);
  if (close) g.closePath();
  g.setLineDash(dash);
  g.lineWidth = width;
  g.strokeStyle = colour;
  g.stroke();
  g.setLineDash([]);
}

function ring(pen, [x, y], radius, colour, { width = 1, dash = [] } = {}) {
  const { g } = pen;
  g.beginPath();
  g.arc(x, y, radius, 0, 2 * Math.PI);
  g.setLineDash(dash);
  g.lineWidth = width;
  g.strokeStyle = colour;
  g.stroke();
  g.setLineDash([]);
}

/** Text with a halo in the background colour, so that it is legible on lines. */
function write(pen, text, x, y, colour, { align = "left", bold = false, size = 12 } = {}) {
  const { g } = pen;
  g.font = `${bold ? "700 " : ""}${size}px ${MONO}`;
  g.textAlign = align;
  g.textBaseline = "middle";
  g.lineJoin = "round";
  g.lineWidth = 4;
  g.strokeStyle = pen.colour.radar;
  g.strokeText(text, x, y);
  g.fillStyle = colour;
  g.fillText(text, x, y);
}

function drawArea(pen, sector) {
  const { g, colour } = pen;
  g.fillStyle = colour.radar;
  g.fillRect(0, 0, pen.width, pen.height);
  const outline = sector.area.map(([x, y]) => pen.at(x, y));
  g.beginPath();
  for (const [x, y] of outline) g.lineTo(x, y);
  g.closePath();
  g.fillStyle = colour.area;
  g.fill();
  stroke(pen, outline, colour["area-line"], { width: 1.5, close: true });
}

/** The points of a leg: its two fixes, and more if the geodesic bends in the plane. */
function legPoints(sector, from, to) {
  const known = sector.bent_legs[JSON.stringify([from, to])];
  return known ?? [sector.fixes[from], sector.fixes[to]];
}

function drawAirways(pen, sector) {
  const legs = new Map();
  for (const route of sector.routes) {
    for (let leg = 1; leg < route.length; leg++) {
      const ends = [route[leg - 1], route[leg]];
      legs.set(JSON.stringify([...ends].sort()), ends);
    }
  }
  for (const ends of legs.values()) {
    stroke(pen, legPoints(sector, ...ends).map((at) => pen.at(...at)), pen.colour.airway);
  }
}

function drawRoute(pen, sector, { route }) {
  const legs = route.slice(1).map((fix, before) => legPoints(sector, route[before], fix));
  const points = legs.flat().map((at) => pen.at(...at));
  stroke(pen, points, pen.colour.selected, { width: 1.5, dash: [7, 5] });
}

/** Fixes in pixels with the boxes of their names: below, or on the side away from a close fix. */
function fixesOn(pen, sector) {
  const size = pen.width < 480 ? 10 : 11;
  const at = Object.values(sector.fixes).map((position) => pen.at(...position));
  return Object.keys(sector.fixes).map((name, index) => {
    const [x, y] = at[index];
    const [right, down] = awayFromNearest(index, at);
    const width = name.length * size * 0.61;
    const left = x + 9 * right + (right > 0 ? 0 : right < 0 ? -width : -width / 2);
    return { name, size, at: at[index], left, top: y + 12 * down - 7, width, height: 14 };
  });
}

function awayFromNearest(index, positions) {
  const [x, y] = positions[index];
  const gaps = positions
    .filter((_, other) => other !== index)
    .map((position) => [x - position[0], y - position[1]])
    .sort((one, other) => Math.hypot(...one) - Math.hypot(...other));
  const nearest = gaps[0] ?? [Infinity, Infinity];
  if (Math.hypot(...nearest) > 60) return [0, 1.15];
  return [Math.sign(nearest[0]), Math.abs(nearest[1]) < 12 ? 0 : Math.sign(nearest[1]) * 0.7];
}

function drawFixes(pen, fixes) {
  const { fix: colour } = pen.colour;
  for (const { name, size, at, left, top } of fixes) {
    const [x, y] = at;
    stroke(pen, [[x, y - 5], [x + 5, y + 4], [x - 5, y + 4]], colour, { close: true });
    write(pen, name, left, top + 7, colour, { size });
  }
}

const SAME_SCALE = 0.02; // relative difference of lengths that is not visible

/** A scale bar of a round number of NM, true in the middle of the picture; returns its box. */
function drawScale(pen) {
  const [low, middle, high] = pen.seen.map(pen.nm);
  const nm = [100, 50, 20, 10, 5, 2, 1].find((each) => each * middle <= pen.width / 4) ?? 1;
  const [x, y, length] = [14, pen.height - 14, nm * middle];
  const where = Math.abs(high - low) > SAME_SCALE * middle ? " mid-screen" : "";
  stroke(pen, [[x, y - 5], [x, y], [x + length, y], [x + length, y - 5]], pen.colour.muted);
  write(pen, `${nm} NM${where}`, x + length + 8, y - 3, pen.colour.muted, { size: 11 });
  return { left: 0, top: y - 10, width: x + length + 60 + 7 * where.length, height: 24 };
}

/** The position of an aircraft, interpolated between its row and the next. */
function positionOf(aircraft, row, part) {
  const next = Math.min(row + 1, aircraft.rows - 1);
  const between = (values) => values[row] + part * (values[next] - values[row]);
  return [between(aircraft.xNm), between(aircraft.yNm)];
}

function ahead(pen, aircraft, row, position, degrees, seconds) {
  return pen.plane.reached(position, degrees, (aircraft.speedKt[row] * seconds) / 3600);
}

/** The trail of an aircraft; older positions are fainter. */
function drawTrail(pen, aircraft, row, { colour, trailRows }) {
  const { g } = pen;
  const rows = Math.min(trailRows, row - aircraft.begins);
  g.fillStyle = colour;
  for (let back = 1; back <= rows; back++) {
    const [x, y] = pen.at(aircraft.xNm[row - back], aircraft.yNm[row - back]);
    g.globalAlpha = 1 - (0.8 * back) / rows;
    g.fillRect(x - 1.2, y - 1.2, 2.4, 2.4);
  }
  g.globalAlpha = 1;
}

/** The symbol of an aircraft: a square; a diamond in a conflict; filled and crossed in a loss. */
function drawSymbol(pen, [x, y], { kind, colour, selected }) {
  const { g } = pen;
  const half = kind === "loss" ? 5.5 : kind === "conflict" ? 6.5 : 4;
  const corners = kind === "conflict" ? [[0, -1], [1, 0], [0, 1], [-1, 0]] : [[-1, -1], [1, -1], [1, 1], [-1, 1]];
  g.beginPath();
  for (const [right, down] of corners) g.lineTo(x + right * half, y + down * half);
  g.closePath();
  g.fillStyle = kind === "loss" ? colour : pen.colour.radar;
  g.fill();
  g.lineWidth = selected ? 2.5 : 1.6;
  g.strokeStyle = colour;
  g.stroke();
  if (kind === "loss") {
    for (const side of [-1, 1]) {
      stroke(pen, [[x - 4, y - 4 * side], [x + 4, y + 4 * side]], pen.colour.radar, { width: 1.6 });
    }
  }
  if (selected) ring(pen, [x, y], 11, colour, { width: 1.5 });
}

const RINGS = { conflict: { width: 1.6, dash: [6, 4] }, loss: { width: 3 } };

function drawAircraft(pen, aircraft, row, position, look) {
  drawTrail(pen, aircraft, row, look);
  const [x, y] = pen.at(...position);
  const heading = aircraft.headingDeg[row];
  const vector = ahead(pen, aircraft, row, position, heading, look.vectorS);
  stroke(pen, [[x, y], pen.at(...vector)], look.colour, { width: 1.3 });
  const cleared = aircraft.clearedHeadingDeg[row];
  if (threeDigits(cleared) !== threeDigits(heading)) {
    const turned = ahead(pen, aircraft, row, position, cleared, look.vectorS);
    stroke(pen, [[x, y], pen.at(...turned)], look.colour, { dash: [3, 4] });
  }
  if (look.ring) {
    const radius = look.ring * pen.nm(position[1]);
    ring(pen, [x, y], radius, look.colour, RINGS[look.kind] ?? { width: 0.7 });
  }
  drawSymbol(pen, [x, y], look);
}

function drawEncounter(pen, encounter) {
  const colour = pen.colour[encounter.kind];
  const [one, other] = encounter.at.map((position) => pen.at(...position));
  if (encounter.kind === "conflict") {
    stroke(pen, [pen.at(...encounter.from[0]), one], colour, { dash: [2, 5] });
    stroke(pen, [pen.at(...encounter.from[1]), other], colour, { dash: [2, 5] });
    for (const [x, y] of [one, other]) {
      const corners = [[x, y - 4], [x + 4, y], [x, y + 4], [x - 4, y]];
      stroke(pen, corners, colour, { width: 1.5, close: true });
    }
    stroke(pen, [one, other], colour, { width: 2, dash: [6, 4] });
    return;
  }
  stroke(pen, [one, other], colour, { width: 3 });
}

function drawBlock(pen, block) {
  const [x, y] = block.at;
  const { left, top, width, height } = block.box;
  const foot = [
    Math.min(Math.max(x, left), left + width),
    Math.min(Math.max(y, top), top + height),
  ];
  const distance = Math.hypot(foot[0] - x, foot[1] - y);
  if (distance > 8) {
    const start = [x + ((foot[0] - x) * 7) / distance, y + ((foot[1] - y) * 7) / distance];
    stroke(pen, [start, foot], block.colour, { width: 0.8 });
  }
  const toLeft = left + width <= x; // text is aligned to the aircraft's side of the box
  block.lines.forEach((line, number) => {
    const middle = top + (number + 0.5) * BLOCK_LINE_PX;
    const look = { align: toLeft ? "right" : "left", bold: number === 0 };
    write(pen, line, toLeft ? left + width - 2 : left + 2, middle, block.colour, look);
  });
}
