// What the viewer has chosen to see: rings, vectors, trails and levels.

const VECTORS_MIN = [1, 2, 5];
const TRAILS = [
  [0, "none"],
  [8, "8 cycles"],
  [20, "20 cycles"],
  [1e6, "whole flight"],
];
const SMALL = 12; // aircraft: the rings of more would cover the picture, their strips need the room
const LOWEST_FL = 0;
const HIGHEST_FL = 999;

class Display {
  constructor(replay) {
    const scenarios = replay.runs.flatMap((run) => run.scenarios);
    const isSmall = Math.max(...scenarios.map((each) => each.aircraft.length)) <= SMALL;
    const isLevel = ({ kind }) => kind === "level";
    this.rings = isSmall;
    this.profile = isSmall && scenarios.some((each) => each.clearances.some(isLevel));
    this.vectorMin = VECTORS_MIN[0];
    this.trailRows = 8;
    this.fromFl = LOWEST_FL;
    this.toFl = HIGHEST_FL;
    this.measuring = false;
  }

  get vectorS() {
    return this.vectorMin * 60;
  }

  nextVector() {
    this.vectorMin = nextOf(VECTORS_MIN, this.vectorMin);
  }

  nextTrail() {
    this.trailRows = nextOf(TRAILS.map(([rows]) => rows), this.trailRows);
  }

  /** Sets the level filter; what is not a number means no limit. */
  setLevels(from, to) {
    this.fromFl = Number.isFinite(from) ? from : LOWEST_FL;
    this.toFl = Number.isFinite(to) ? to : HIGHEST_FL;
  }

  get isFiltered() {
    return this.fromFl > LOWEST_FL || this.toFl < HIGHEST_FL;
  }

  /** Whether an aircraft is in the chosen levels, or climbs or descends through them. */
  hasLevel(aircraft, row) {
    const last = Math.min(row, aircraft.rows - 1);
    const [fl, clearedFl] = [aircraft.fl[last], aircraft.clearedFl[last]];
    return Math.max(fl, clearedFl) >= this.fromFl && Math.min(fl, clearedFl) <= this.toFl;
  }
}

function nextOf(values, value) {
  return values[(values.indexOf(value) + 1) % values.length];
}
