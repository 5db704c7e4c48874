// One radar on the page: what it shows of a run, and which aircraft is at the pointer.

const NEAR_PX = 24; // the maximum distance of a click
const LETTER_PX = 7.25;
const LABELLED = 12; // encounters; with more, labels would cover the picture

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
  }

  /** Selects what to draw of a scenario at a row; returns the encounters. */
  show(scenario, row) {
    this.flying = onRadar(scenario, row);
    this.encounters = encountersAt(this.plane, scenario, row, this.limits);
    this.row = row;
    this.settled = false;
    return this.encounters;
  }

  /** Draws everything; `part` is the fraction of the cycle that has passed since the row. */
  draw(part, selected, rings) {
    const { sector, flying, encounters, row } = this;
    const pen = penOf(this.canvas, this.view, this.plane);
    const fixes = fixesOn(pen, sector);
    drawArea(pen, sector);
    drawAirways(pen, sector);
    for (const aircraft of flying) {
      if (aircraft.callsign === selected) drawRoute(pen, sector, aircraft);
    }
    drawFixes(pen, fixes);
    drawScale(pen);
    for (const each of encounters) drawEncounter(pen, each);
    const drawn = flying.map((aircraft) => {
      const position = positionOf(aircraft, row, part);
      const look = this.look(pen, aircraft, selected, rings);
      drawAircraft(pen, aircraft, row, position, look);
      return this.blockOf(pen, aircraft, position, look.colour);
    });
    const labels = encounters.slice(0, LABELLED).map((each) => labelOf(pen, each));
    this.blocks = [...drawn, ...labels.filter(({ at }) => isOn(pen, at))];
    this.place(pen, fixes, part > 0);
    for (const block of this.blocks) drawBlock(pen, block);
  }

  look(pen, aircraft, selected, rings) {
    const kind = this.encounters.find((each) => each.pair.includes(aircraft))?.kind;
    const isSelected = aircraft.callsign === selected;
    const waiting = statusAt(aircraft, this.row) === "before_entry";
    const plain = isSelected ? "selected" : waiting ? "waiting" : "aircraft";
    return {
      colour: pen.colour[kind ?? plain],
      selected: isSelected,
      strong: Boolean(kind),
      ring: rings || kind || isSelected ? this.ringNm : 0,
    };
  }

  blockOf(pen, aircraft, position, colour) {
    const lines = blockLines(aircraft, this.row);
    const headings = [aircraft.headingDeg[this.row], aircraft.clearedHeadingDeg[this.row]];
    const vector = (heading, part) =>
      pen.at(...ahead(pen, aircraft, this.row, position, heading, part * VECTOR_S));
    return {
      callsign: aircraft.callsign,
      name: aircraft.callsign,
      lines,
      colour,
      at: pen.at(...position),
      ahead: headings.flatMap((heading) => [vector(heading, 0.5), vector(heading, 1)]),
      ...sizeOf(lines),
    };
  }

  /** Places the blocks, which keep their slots within a cycle. */
  place(pen, fixes, moving) {
    for (const block of this.blocks) block.slot = this.slots.get(block.name);
    if (!moving || !this.settled) {
      const canvas = { left: 2, top: 2, width: pen.width - 4, height: pen.height - 4 };
      chooseSlots(this.blocks, fixes, canvas);
      this.slots = new Map(this.blocks.map((block) => [block.name, block.slot]));
      this.settled = true;
    }
    for (const block of this.blocks) {
      block.box = boxIn(SLOTS[block.slot], block.at, block.width, block.height);
    }
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

function sizeOf(lines) {
  const letters = Math.max(...lines.map((line) => [...line].length));
  return { width: letters * LETTER_PX + 4, height: lines.length * BLOCK_LINE_PX };
}

/** The label of an encounter, next to the line between the positions where separation is lost. */
function labelOf(pen, encounter) {
  const [one, other] = encounter.at.map((position) => pen.at(...position));
  const between = (part) => [0, 1].map((axis) => one[axis] + part * (other[axis] - one[axis]));
  return {
    name: JSON.stringify(encounter.pair.map((aircraft) => aircraft.callsign)),
    lines: [encounter.text],
    colour: pen.colour[encounter.kind],
    at: between(0.5),
    ahead: [one, between(0.25), between(0.75), other],
    ...sizeOf([encounter.text]),
  };
}
