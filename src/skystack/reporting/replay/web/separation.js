// Which aircraft have lost separation, and which will if they keep their tracks and speeds.

const LOOK_AHEAD_S = 600;
const PIECE_S = 60; // a straight relative motion is within 0.01 NM of the true one for as long
const PIECES = (2 * LOOK_AHEAD_S) / PIECE_S; // a predicted loss is followed beyond its beginning
const SAME_FL = 1e-4; // less than the unit of levels, 1/6000
const FT_MIN_PER_FL_S = 6000;

/** Where an aircraft will be at the ends of the pieces, and how its level will change. */
function projected(plane, aircraft, row) {
  const places = [[aircraft.xNm[row], aircraft.yNm[row]]];
  const pieceNm = (aircraft.speedKt[row] * PIECE_S) / 3600;
  for (let piece = 0; piece < PIECES; piece++) {
    places.push(plane.reached(places[piece], aircraft.headingDeg[row], pieceNm));
  }
  const [fl, clearedFl] = [aircraft.fl[row], aircraft.clearedFl[row]];
  // Cleared, but not climbing or descending yet: it will.
  const rate = Math.abs(aircraft.climbFtMin[row]) || aircraft.usualClimbFtMin;
  const flPerS = (Math.sign(clearedFl - fl) * rate) / FT_MIN_PER_FL_S;
  const levelsOffS = flPerS ? (clearedFl - fl) / flPerS : 0;
  return { places, fl, clearedFl, flPerS, levelsOffS };
}

function levelAfter(path, seconds) {
  return seconds < path.levelsOffS ? path.fl + path.flPerS * seconds : path.clearedFl;
}

/** Spans of seconds in which two are less than `limitFl` apart, in order: the difference is linear
 *  between the moments at which either levels off. */
function timesVerticallyClose(one, other, limitFl) {
  const last = PIECES * PIECE_S;
  const bends = [one.levelsOffS, other.levelsOffS].filter((each) => each > 0 && each < last);
  const times = [0, ...bends.sort((a, b) => a - b), last];
  const gaps = times.map((each) => levelAfter(other, each) - levelAfter(one, each));
  const limit = limitFl - SAME_FL;
  const spans = [];
  for (let piece = 1; piece < times.length; piece++) {
    const [from, gap, change] = [times[piece - 1], gaps[piece - 1], gaps[piece] - gaps[piece - 1]];
    const duration = times[piece] - from;
    if (change === 0) {
      if (Math.abs(gap) < limit) spans.push([from, times[piece]]);
      continue;
    }
    const parts = [(-limit - gap) / change, (limit - gap) / change].sort((a, b) => a - b);
    const [begin, end] = [Math.max(parts[0], 0), Math.min(parts[1], 1)];
    if (begin < end) spans.push([from + begin * duration, from + end * duration]);
  }
  return spans;
}

/** Least distance `nm` within parts `from` to `to` of a straight way between two offsets, and the
 *  part in which it first is less than a limit; null if it never is. */
function closestWithin([x, y], [endX, endY], from, to, limit) {
  const [vx, vy] = [endX - x, endY - y];
  const [square, along] = [vx * vx + vy * vy, x * vx + y * vy];
  const distance = (part) => Math.hypot(x + part * vx, y + part * vy);
  const part = square > 0 ? Math.min(Math.max(-along / square, from), to) : from;
  const nm = distance(part);
  if (nm >= limit) return null;
  if (distance(from) < limit) return { nm, begins: from };
  const root = Math.sqrt(along * along - square * (x * x + y * y - limit * limit));
  return { nm, begins: Math.max((-along - root) / square, from) };
}

/** The predicted loss of separation: `seconds` until it begins, `at`, where both are then, and the
 *  least distance `nm` while they are vertically close. Null if there is none in time. */
function conflictOf(plane, one, other, limits) {
  let found = null;
  for (const [begin, end] of timesVerticallyClose(one, other, limits.fl)) {
    for (let piece = Math.floor(begin / PIECE_S); piece * PIECE_S < end; piece++) {
      const starts = piece * PIECE_S;
      if (!found && starts > LOOK_AHEAD_S) return null;
      const [before, after] = [piece, piece + 1].map((end) =>
        plane.offset(one.places[end], other.places[end]),
      );
      const [from, to] = [begin, end].map((time) => Math.min(Math.max(time - starts, 0), PIECE_S));
      const met = closestWithin(before, after, from / PIECE_S, to / PIECE_S, limits.nm);
      if (!met) continue;
      const seconds = starts + met.begins * PIECE_S;
      if (!found && seconds > LOOK_AHEAD_S) return null;
      found ??= { seconds, nm: met.nm, at: [one, other].map(placeWithin(piece, met.begins)) };
      found.nm = Math.min(found.nm, met.nm);
    }
  }
  return found;
}

const placeWithin = (piece, part) => ({ places }) => {
  const [from, to] = [places[piece], places[piece + 1]];
  return from.map((start, axis) => start + part * (to[axis] - start));
};

/** One decimal, rounded down: 4.99 NM is no 5.0. */
function nmText(nm) {
  return `${(Math.floor(nm * 10 + 1e-6) / 10).toFixed(1)} NM`;
}

/** How close two are that have lost separation at a row or in the cycle before it, else null. */
function lossText(plane, scenario, [first, second], row, limits) {
  const [one, other] = [scenario.aircraft[first], scenario.aircraft[second]];
  const [from, to] = [one, other].map((each) => [each.xNm[row], each.yNm[row]]);
  const distance = Math.hypot(...plane.offset(from, to));
  const levels = Math.abs(one.fl[row] - other.fl[row]);
  if (distance < limits.nm && levels < limits.fl - SAME_FL) return nmText(distance);
  const within = scenario.losses.find(
    (loss) =>
      loss.first === first && loss.second === second && loss.begins < row && row <= loss.ends,
  );
  return within ? `least ${nmText(within.least_nm)}` : null;
}

/**
 * Losses of separation at a row, then predicted ones, the soonest first: the `pair` of aircraft,
 * `from` where they are, `at` where they will lose separation, `text` how soon and how close they
 * will be. `limits`: distances below `nm` with level differences below `fl` are a loss.
 */
function encountersAt(plane, scenario, row, limits) {
  const seen = scenario.aircraft.map((each) => row < each.rows);
  const paths = scenario.aircraft.map((each, index) => seen[index] && projected(plane, each, row));
  const gone = scenario.aircraft.map((each) => statusAt(each, row) === "exited");
  const found = [];
  for (let second = 1; second < paths.length; second++) {
    for (let first = 0; first < second; first++) {
      const [one, other] = [paths[first], paths[second]];
      if (!one || !other) continue;
      const who = { pair: [scenario.aircraft[first], scenario.aircraft[second]] };
      const from = [one.places[0], other.places[0]];
      const lost = lossText(plane, scenario, [first, second], row, limits);
      if (lost) found.push({ kind: "loss", ...who, from, at: from, seconds: 0, text: lost });
      if (lost || gone[first] || gone[second]) continue;
      const met = conflictOf(plane, one, other, limits);
      if (!met) continue;
      const text = `in ${minutes(met.seconds)}, least ${nmText(met.nm)}`;
      found.push({ kind: "conflict", ...who, from, ...met, text });
    }
  }
  const lost = (each) => Number(each.kind === "loss");
  return found.sort((one, other) => lost(other) - lost(one) || one.seconds - other.seconds);
}
