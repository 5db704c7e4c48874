// A run that grows: cycles and clearances are added to it as they arrive.

const FLIGHT_STATUS = ["before_entry", "in_sector", "exited", "excursion"];

function emptyRun(run) {
  Object.assign(run, { cycles: 0, hasArrivals: true, aircraft: [], losses: [], failures: [] });
  Object.assign(run, { clearances: [], transmissions: [] });
}

/** Adds an update of the server to a run. */
function grow(run, update) {
  if (update.cycle === undefined) addClearances(run, update);
  else addCycle(run, update);
}

function addCycle(run, { cycle, born, flights, gone, losses }) {
  run.cycles = cycle;
  for (const each of born) run.aircraft.push(newAircraft(each, cycle));
  for (const [number, ...values] of flights) addRow(run.aircraft[number], cycle, values);
  for (const [number, how] of gone) addFailure(run, number, how);
  for (const [first, second, nm] of losses) addLoss(run, first, second, nm, cycle);
}

function newAircraft(born, begins) {
  const empty = () => new Array(begins).fill(NaN);
  return {
    callsign: born.callsign,
    type: born.type,
    route: born.route,
    begins,
    rows: begins,
    entryFl: born.entry_fl,
    exitFl: born.exit_fl,
    exitOffsetNm: null,
    maxClimbFtMin: CLIMB_FT_MIN,
    ...{ xNm: empty(), yNm: empty(), fl: empty(), headingDeg: empty(), clearedHeadingDeg: empty() },
    ...{ clearedFl: empty(), speedKt: empty(), climbFtMin: empty() },
    status: [],
  };
}

const ROW = ["xNm", "yNm", "fl", "headingDeg", "clearedHeadingDeg", "clearedFl", "speedKt", "climbFtMin"];

function addRow(aircraft, row, values) {
  ROW.forEach((name, place) => aircraft[name].push(values[place]));
  aircraft.rows = row + 1;
  const status = FLIGHT_STATUS[values[ROW.length]];
  if (aircraft.status.at(-1)?.[1] !== status) aircraft.status.push([row, status]);
}

function addFailure(run, number, how) {
  if (how === "correct") return;
  const known = run.failures.find(({ reason }) => reason === how);
  if (known) known.aircraft.push(number);
  else run.failures.push({ reason: how, aircraft: [number] });
}

function addLoss(run, first, second, nm, row) {
  const isSame = (loss) => loss.first === first && loss.second === second && loss.ends === row - 1;
  const known = run.losses.find(isSame);
  if (known) Object.assign(known, { ends: row, least_nm: Math.min(known.least_nm, nm) });
  else run.losses.push({ first, second, begins: row - 1, ends: row, least_nm: nm });
}

function addClearances(run, update) {
  const aircraft = run.aircraft[update.aircraft];
  const issued = update.clearances.map((each) => ({
    ...each,
    aircraft: update.aircraft,
    callsign: aircraft.callsign,
    row: each.cycle + 1,
  }));
  run.clearances.push(...issued);
  if (issued.length) run.transmissions.push(issued[0]);
  // What was cleared is shown at once, before the first cycle in which it is flown.
  const last = aircraft.rows - 1;
  aircraft.clearedHeadingDeg[last] = update.cleared_heading;
  aircraft.clearedFl[last] = update.cleared_fl;
}
