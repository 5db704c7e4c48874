// What was flown, unpacked from the JSON that the page carries.

/** Differences from row to row added up; those missing at the end are zero. */
function summed(differences, rows, unit) {
  const values = new Float64Array(rows);
  let whole = 0;
  for (let row = 0; row < rows; row++) {
    whole += differences[row] ?? 0;
    values[row] = whole / unit;
  }
  return values;
}

/** Plane length per true length, as a function of the distance [NM] north of the origin. */
function scaleOf({ coefficients, range_nm: range }) {
  return (y) => {
    const reduced = Math.min(Math.max(y / range, -1), 1);
    return coefficients.reduceRight((value, each) => value * reduced + each, 0);
  };
}

const UNKNOWN_CLIMB_FT_MIN = 2000;

function unpackAircraft(packed, scale) {
  const column = (name, unit = 1) => summed(packed[name], packed.rows, unit);
  const climbFtMin = column("climb_ft_min");
  return {
    callsign: packed.callsign,
    type: packed.type,
    route: packed.route,
    rows: packed.rows,
    entryFl: packed.entry_fl,
    exitFl: packed.exit_fl,
    xNm: column("x", scale.nm),
    yNm: column("y", scale.nm),
    fl: column("fl", scale.fl),
    headingDeg: column("heading", scale.deg),
    clearedHeadingDeg: column("cleared_heading", scale.deg),
    clearedFl: column("cleared_fl", scale.fl),
    speedKt: column("speed_kt", scale.kt),
    climbFtMin,
    usualClimbFtMin: climbFtMin.reduce((a, b) => Math.max(a, Math.abs(b)), 0) || UNKNOWN_CLIMB_FT_MIN,
    status: packed.status,
  };
}

/** One scenario of one run, ready to be drawn. */
function unpackScenario(packed, scale) {
  const aircraft = packed.aircraft.map((each) => unpackAircraft(each, scale));
  return {
    cycles: packed.cycles,
    success: packed.success,
    aircraft,
    losses: packed.losses,
    clearances: packed.clearances.map((said) => ({
      ...said,
      callsign: aircraft[said.aircraft].callsign,
      row: said.cycle + 1, // the first that shows it as cleared
    })),
  };
}

function statusAt(aircraft, row) {
  return aircraft.status.findLast(([from]) => from <= row)[1];
}

/** Whoever is on the radar: an aircraft that has exited is seen once more, in its last row. */
function onRadar(scenario, row) {
  return scenario.aircraft.filter((aircraft) => row < aircraft.rows);
}

/** Heading and cleared heading as said: three digits, north is 360. */
function threeDigits(degrees) {
  return String(((Math.round(degrees) + 359) % 360) + 1).padStart(3, "0");
}

function minutes(seconds) {
  const whole = Math.round(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** "300", or with an arrow what it climbs or descends to. */
function levelText(aircraft, row) {
  const level = String(Math.round(aircraft.fl[row])).padStart(3, "0");
  const left = aircraft.clearedFl[row] - aircraft.fl[row];
  if (Math.abs(left) < 0.5) return level;
  return `${level}${left > 0 ? "↑" : "↓"}${String(aircraft.clearedFl[row]).padStart(3, "0")}`;
}

function counted(number, noun) {
  return `${number} ${noun}${number === 1 ? "" : "s"}`;
}
