// The state of the replay: scenario, row, speed and selection. It does not access the page.

const SPEEDS = [1, 2, 5, 10, 20, 30, 60];
const SMOOTH_UP_TO = 10; // times real time; at higher speeds, rows change too fast for interpolation

const callsignsOf = (run) => run.aircraft.map((aircraft) => aircraft.callsign);

class Player {
  /** `changed(what)` is called with "scenario", "row", "selection" or "playing". */
  constructor(replay, changed) {
    this.replay = replay;
    this.changed = changed;
    this.speed = 20;
    this.selected = null;
    this.partner = null; // the second aircraft of a selected pair
    this.playing = false;
    this.index = 0;
    this.row = 0;
    this.elapsed = 0; // part of the cycle that has passed since the row
    this.runs = [];
  }

  /** What keys and buttons do, for the help. */
  get words() {
    return { toggle: "play or pause", forward: "one cycle forward", end: "go to the end" };
  }

  /** The last row of the timeline. */
  get length() {
    return this.lastRow;
  }

  /** Whether the picture changes by itself. */
  get isMoving() {
    return this.playing;
  }

  get packed() {
    return this.replay.runs[0].scenarios[this.index];
  }

  open(index, row = 0) {
    const last = this.replay.runs[0].scenarios.length - 1;
    this.index = Math.min(Math.max(index, 0), last);
    this.runs = this.replay.runs.map((run) =>
      unpackScenario(run.scenarios[this.index], this.replay.parts),
    );
    this.lastRow = Math.max(...this.runs.map((run) => run.cycles));
    const rows = this.runs.flatMap((run) => run.clearances.map((issued) => issued.row));
    this.clearanceRows = [...new Set(rows)].sort((one, other) => one - other);
    this.callsigns = [...new Set(this.runs.flatMap(callsignsOf))];
    if (!this.callsigns.includes(this.partner)) this.partner = null;
    if (!this.callsigns.includes(this.selected)) [this.selected, this.partner] = [this.partner, null];
    this.changed("scenario");
    this.goTo(row);
  }

  goTo(row) {
    this.row = Math.min(Math.max(row, 0), this.lastRow);
    this.elapsed = 0;
    this.changed("row");
  }

  step(rows) {
    this.play(false);
    this.goTo(this.row + rows);
  }

  toClearance(direction) {
    const row =
      direction > 0
        ? this.clearanceRows.find((each) => each > this.row)
        : this.clearanceRows.findLast((each) => each < this.row);
    this.play(false);
    if (row !== undefined) this.goTo(row);
  }

  toggle() {
    this.play(!this.playing);
  }

  play(playing) {
    if (playing && this.row === this.lastRow) this.goTo(0);
    this.playing = playing;
    this.changed("playing");
  }

  faster(steps) {
    const index = SPEEDS.indexOf(this.speed) + steps;
    this.speed = SPEEDS[Math.min(Math.max(index, 0), SPEEDS.length - 1)];
    this.changed("playing");
  }

  select(callsign, partner = null) {
    this.selected = callsign;
    this.partner = partner === callsign ? null : partner;
    this.changed("selection");
  }

  isSelected(callsign) {
    return callsign === this.selected || callsign === this.partner;
  }

  /** Selects an aircraft, or clears it if it is selected; with `add`, as the second of a pair. */
  pick(callsign, add = false) {
    const { selected, partner } = this;
    if (!add || selected === null) this.select(callsign === selected ? null : callsign);
    else if (callsign === selected) this.select(partner);
    else this.select(selected, callsign === partner ? null : callsign);
  }

  /** Advances the replay by `milliseconds` of the viewer's time. */
  tick(milliseconds) {
    if (!this.playing) return;
    this.elapsed += ((milliseconds / 1000) * this.speed) / this.replay.cycle_s;
    const rows = Math.floor(this.elapsed);
    if (!rows) return;
    const rest = this.elapsed - rows;
    this.goTo(this.row + rows);
    if (this.row === this.lastRow) this.play(false);
    else this.elapsed = rest;
  }
}
