// One radar on the page: what it shows of a run, and which aircraft is at the pointer.

const NEAR_PX = 24; // the maximum distance of a click
const LABELLED = 12; // encounters; with more, labels would cover the picture
const LABELLED_IN_CROWD = 4; // if the data blocks are shortened

class Scope {
  constructor(canvas, replay, view) {
    this.canvas = canvas;
    this.sector = replay.sector;
    this.plane = new Plane(replay.plane);
    this.ringNm = replay.separation_nm;
    this.limits = { nm: replay.loss_below_nm, fl: replay.separation_fl };
    this.view = view;
    this.slots = new Map();
    this.blocks = [];
    this.line = null; // the measuring line
    this.predict = encountersAt; // a live session predicts conflicts itself
    this.overlay = null; // what a page adds to the picture: `{version, draw(pen)}`
  }

  /** Selects what to draw of a scenario at a row; returns the encounters. */
  show(scenario, row) {
    this.scenario = scenario;
    this.flying = onRadar(scenario, row);
    this.encounters = this.predict(this.plane, scenario, row, this.limits);
    this.kinds = new Map();
    for (const { kind, pair } of this.encounters) {
      for (const aircraft of pair) if (!this.kinds.has(aircraft)) this.kinds.set(aircraft, kind);
    }
    this.row = row;
    this.settled = false;
    return this.encounters;
  }

  /** Whether an aircraft passes the level filter, or must be seen because it is selected or in an alert. */
  isShown(aircraft, player, display) {
    const must = this.kinds.has(aircraft) || player.isSelected(aircraft.callsign);
    return must || display.hasLevel(aircraft, this.row);
  }

  /** Draws everything; `part` is the fraction of the cycle that has passed since the row. */
  draw(part, player, display, measure) {
    const { sector, encounters, row } = this;
    const flying = this.flying.filter((each) => this.isShown(each, player, display));
    const pen = penOf(this.canvas, this.view, this.plane);
    const fixes = fixesOn(pen, sector);
    drawArea(pen, sector);
    drawAirways(pen, sector);
    for (const aircraft of flying) {
      if (player.isSelected(aircraft.callsign)) drawRoute(pen, sector, aircraft);
    }
    drawFixes(pen, fixes);
    const keepFree = [...fixes, drawScale(pen)];
    for (const each of encounters) drawEncounter(pen, each);
    const drawn = flying.map((aircraft) => {
      const position = positionOf(aircraft, row, part);
      const look = this.look(pen, aircraft, player, display);
      drawAircraft(pen, aircraft, row, position, look);
      return this.blockOf(pen, aircraft, position, look);
    });
    const blocks = drawn.filter(({ at }) => isOn(pen, at));
    const isFull = shorten(blocks, pen.width * pen.height) === 4;
    const labelled = encounters.slice(0, isFull ? LABELLED : LABELLED_IN_CROWD);
    const labels = labelled.map((each) => labelOf(pen, each));
    this.blocks = [...blocks, ...labels.filter(({ at }) => isOn(pen, at))];
    this.place(pen, keepFree, part > 0);
    for (const block of this.blocks) drawBlock(pen, block);
    this.line = measure.on(this.plane, this.flying, player.selected, row, part);
    if (this.line) drawMeasure(pen, this.line);
    this.overlay?.draw(pen);
  }

  look(pen, aircraft, player, { rings, vectorS, trailRows }) {
    const kind = this.kinds.get(aircraft);
    const isSelected = player.isSelected(aircraft.callsign);
    const waiting = statusAt(aircraft, this.row) === "before_entry";
    const plain = isSelected ? "selected" : waiting ? "waiting" : "aircraft";
    return {
      ...{ kind, vectorS, trailRows },
      colour: pen.colour[kind ?? plain],
      selected: isSelected,
      ring: rings || kind || isSelected ? this.ringNm : 0,
    };
  }

  blockOf(pen, aircraft, position, { colour, vectorS, kind, selected }) {
    const lines = blockLines(aircraft, this.row);
    const headings = [aircraft.headingDeg[this.row], aircraft.clearedHeadingDeg[this.row]];
    const vector = (heading, part) =>
      pen.at(...ahead(pen, aircraft, this.row, position, heading, part * vectorS));
    return {
      callsign: aircraft.callsign,
      name: aircraft.callsign,
      lines,
      colour,
      least: selected || lines.length > 3 ? 4 : kind ? 2 : 1,
      at: pen.at(...position),
      ahead: headings.flatMap((heading) => [vector(heading, 0.5), vector(heading, 1)]),
    };
  }

  /** Places the blocks, which keep their slots within a cycle. */
  place(pen, keepFree, moving) {
    for (const block of this.blocks) block.slot = this.slots.get(block.name);
    if (!moving || !this.settled) {
      const canvas = { left: 2, top: 2, width: pen.width - 4, height: pen.height - 4 };
      chooseSlots(this.blocks, keepFree, canvas);
      this.slots = new Map(this.blocks.map((block) => [block.name, block.slot]));
      this.settled = true;
    }
    for (const block of this.blocks) {
      block.box = boxIn(SLOTS[block.slot], block.at, block.width, block.height);
    }
  }

  /** An end of a measuring line at a point: the aircraft there, or the position. */
  endAt([x, y]) {
    const callsign = this.hit(x, y);
    if (callsign !== null) return { callsign };
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return { point: this.view.toPlane(width, height)(x, y) };
  }

  /** The callsign whose aircraft or data block is at a point, or null. */
  hit(x, y) {
    const aircraft = this.blocks.filter((block) => block.callsign !== undefined);
    const distance = ({ at }) => Math.hypot(at[0] - x, at[1] - y);
    const [nearest] = [...aircraft].sort((one, other) => distance(one) - distance(other));
    if (nearest && distance(nearest) <= NEAR_PX) return nearest.callsign;
    const point = { left: x, top: y, width: 1, height: 1 };
    return aircraft.find(({ box }) => overlap(box, point) > 0)?.callsign ?? null;
  }
}

const isOn = (pen, [x, y]) => x >= 0 && x <= pen.width && y >= 0 && y <= pen.height;

/** The label of an encounter, next to the line between the positions where separation is lost. */
function labelOf(pen, encounter) {
  const [one, other] = encounter.at.map((position) => pen.at(...position));
  const text = encounter.kind === "loss" ? `LOSS ${encounter.text}` : encounter.text;
  const between = (part) => [0, 1].map((axis) => one[axis] + part * (other[axis] - one[axis]));
  return {
    name: JSON.stringify(encounter.pair.map((aircraft) => aircraft.callsign)),
    lines: [text],
    colour: pen.colour[encounter.kind],
    at: between(0.5),
    ahead: [one, between(0.25), between(0.75), other],
    ...sizeOf([text]),
  };
}
