// Finds the rows with predicted conflicts in a whole scenario, in slices while the page is idle.

const SLICE_MS = 8;

class Scan {
  /** `found(lane, [begins, ends])` is called for each span of rows with a conflict in a run. */
  constructor(plane, limits, found) {
    Object.assign(this, { plane, limits, found, timer: 0 });
  }

  /** Starts again with the runs of another scenario. */
  open(runs) {
    clearTimeout(this.timer);
    const lanes = runs.map((run, lane) => this.rowsOf(run, lane));
    const work = () => {
      const until = performance.now() + SLICE_MS;
      while (lanes.length && performance.now() < until) {
        if (lanes[0].next().done) lanes.shift();
      }
      if (lanes.length) this.timer = setTimeout(work);
    };
    this.timer = setTimeout(work, 50);
  }

  *rowsOf(run, lane) {
    let begins = null;
    for (let row = 0; row <= run.cycles; row++) {
      const encounters = encountersAt(this.plane, run, row, this.limits);
      const isConflict = encounters.some((each) => each.kind === "conflict");
      if (isConflict) begins ??= row;
      if (begins !== null && (!isConflict || row === run.cycles)) {
        this.found(lane, [begins, row]);
        begins = null;
      }
      yield;
    }
  }
}
