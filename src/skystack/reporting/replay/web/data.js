// The recorded flights, unpacked from the JSON in the page.

const CLIMB_FT_MIN = 2000; // for aircraft that never climb or descend in the recording

/** Values from their second differences; those missing at the end are zero. Values before row
 *  `begins` are NaN. */
function summed(differences, begins, rows, parts) {
  const values = new Float64Array(begins + rows).fill(NaN, 0, begins);
  let [whole, step] = [0, 0];
  for (let row = 0; row < rows; row++) {
    step += differences[row] ?? 0;
    whole += step;
    values[begins + row] = whole / parts;
  }
  return values;
}

/** `parts`: the resolution of each unit; values are stored as multiples of 1 / `parts`. */
function unpackAircraft(packed, parts) {
  const { begins, rows } = packed;
  const column = (name, each) => summed(packed[name], begins, rows, each);
  const climbFtMin = column("climb_ft_min", parts.ft_min);
  return {
    callsign: packed.callsign,
    type: packed.type,
    route: packed.route,
    begins, // the row in which it appears
    rows: begins + rows, // the row after its last one
    entryFl: packed.entry_fl,
    exitFl: packed.exit_fl,
    exitOffsetNm: packed.exit_offset_nm, // null if it has not exited, or if it is not recorded
    xNm: column("x", parts.nm),
    yNm: column("y", parts.nm),
    fl: column("fl", parts.fl),
    headingDeg: column("heading", parts.deg),
    clearedHeadingDeg: column("cleared_heading", parts.deg),
    clearedFl: column("cleared_fl", parts.fl),
    speedKt: column("speed_kt", parts.kt),
    climbFtMin,
    maxClimbFtMin: Math.max(...climbFtMin.subarray(begins).map(Math.abs)) || CLIMB_FT_MIN,
    status: packed.status.map(([row, status]) => [begins + row, status]),
  };
}

/** The clearances without the second element of those with a heading and a level. */
function transmissionsOf(clearances) {
  const seen = new Set();
  return clearances.filter(({ aircraft, cycle }) => seen.size < seen.add(`${aircraft} ${cycle}`).size);
}

/** One scenario of one run, ready to be drawn. */
function unpackScenario(packed, parts) {
  const aircraft = packed.aircraft.map((each) => unpackAircraft(each, parts));
  const clearances = packed.clearances.map((issued) => ({
    ...issued,
    callsign: aircraft[issued.aircraft].callsign,
    row: issued.cycle + 1, // the first that shows it as cleared
  }));
  return {
    cycles: packed.cycles,
    hasArrivals: aircraft.some((each) => each.begins > 0),
    success: packed.success,
    failures: packed.failures,
    aircraft,
    losses: packed.losses,
    clearances,
    transmissions: transmissionsOf(clearances),
  };
}

/** The status at a row; before the aircraft appears, its first status. */
function statusAt(aircraft, row) {
  const { status } = aircraft;
  return (status.findLast(([from]) => from <= row) ?? status[0])[1];
}

/** Whether an aircraft is on the radar. One that has exited is still shown in its last row. */
function isFlying(aircraft, row) {
  return aircraft.begins <= row && row < aircraft.rows;
}

function onRadar(scenario, row) {
  return scenario.aircraft.filter((aircraft) => isFlying(aircraft, row));
}

/** A heading as spoken: three digits, north is 360. */
function threeDigits(degrees) {
  return String(((Math.round(degrees) + 359) % 360) + 1).padStart(3, "0");
}

function minutes(seconds) {
  const whole = Math.round(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** "300", or with an arrow and the cleared level while climbing or descending. */
function levelText(aircraft, row) {
  const level = String(Math.round(aircraft.fl[row])).padStart(3, "0");
  const left = aircraft.clearedFl[row] - aircraft.fl[row];
  if (Math.abs(left) < 0.5) return level;
  return `${level}${left > 0 ? "↑" : "↓"}${String(aircraft.clearedFl[row]).padStart(3, "0")}`;
}

function counted(number, noun) {
  return `${number} ${noun}${number === 1 ? "" : "s"}`;
}
