// Losses of separation: current ones, and those predicted at constant tracks and speeds.

const LOOK_AHEAD_S = 600;
const PIECE_S = 60; // within this time, straight relative motion is accurate to 0.01 NM
const PIECES = (2 * LOOK_AHEAD_S) / PIECE_S; // a predicted loss is followed after it begins
const SAME_FL = 1e-4; // less than the resolution of levels, 1/6000
const FT_MIN_PER_FL_S = 6000;

/** The predicted positions at the ends of the pieces, and the predicted change of level. */
function projected(plane, aircraft, row) {
  const positions = [[aircraft.xNm[row], aircraft.yNm[row]]];
  const pieceNm = (aircraft.speedKt[row] * PIECE_S) / 3600;
  for (let piece = 0; piece < PIECES; piece++) {
    positions.push(plane.reached(positions[piece], aircraft.headingDeg[row], pieceNm));
  }
  const [fl, clearedFl] = [aircraft.fl[row], aircraft.clearedFl[row]];
  // Cleared but not climbing or descending yet: assume its largest recorded rate.
  const rate = Math.abs(aircraft.climbFtMin[row]) || aircraft.maxClimbFtMin;
  const flPerS = (Math.sign(clearedFl - fl) * rate) / FT_MIN_PER_FL_S;
  const levelsOffS = flPerS ? (clearedFl - fl) / flPerS : 0;
  return { positions, fl, clearedFl, flPerS, levelsOffS };
}

function levelAfter(path, seconds) {
  return seconds < path.levelsOffS ? path.fl + path.flPerS * seconds : path.clearedFl;
}

/** Time spans in seconds, in order, in which two aircraft are less than `limitFl` apart. The
 *  difference of levels is linear between the times at which either levels off. */
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

/** The minimum distance `nm` on a straight line between two offsets, from fraction `from` to `to`,
 *  and the fraction `begins` at which it first is below a limit; null if it never is. */
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

/** The predicted loss of separation: `seconds` until it begins, the positions of both then (`at`), and
 *  the minimum distance `nm` while vertically close. Null if none begins in time. */
function conflictOf(plane, one, other, limits) {
  let found = null;
  for (const [begin, end] of timesVerticallyClose(one, other, limits.fl)) {
    for (let piece = Math.floor(begin / PIECE_S); piece * PIECE_S < end; piece++) {
      const starts = piece * PIECE_S;
      if (!found && starts > LOOK_AHEAD_S) return null;
      const [before, after] = [piece, piece + 1].map((end) =>
        plane.offset(one.positions[end], other.positions[end]),
      );
      const [from, to] = [begin, end].map((time) => Math.min(Math.max(time - starts, 0), PIECE_S));
      const close = closestWithin(before, after, from / PIECE_S, to / PIECE_S, limits.nm);
      if (!close) continue;
      const seconds = starts + close.begins * PIECE_S;
      if (!found && seconds > LOOK_AHEAD_S) return null;
      found ??= { seconds, nm: close.nm, at: [one, other].map(positionWithin(piece, close.begins)) };
      found.nm = Math.min(found.nm, close.nm);
    }
  }
  return found;
}

const positionWithin = (piece, part) => ({ positions }) => {
  const [from, to] = [positions[piece], positions[piece + 1]];
  return from.map((start, axis) => start + part * (to[axis] - start));
};

/** One decimal, rounded down, so that 4.99 NM is not shown as 5.0. */
function nmText(nm) {
  return `${(Math.floor(nm * 10 + 1e-6) / 10).toFixed(1)} NM`;
}

/** The recorded losses in the cycle that ends at a row, by `first` * `count` + `second`. */
function lossesAt({ losses, aircraft }, row) {
  const found = new Map();
  for (const loss of losses) {
    const key = loss.first * aircraft.length + loss.second;
    if (loss.begins < row && row <= loss.ends && !found.has(key)) found.set(key, loss);
  }
  return found;
}

/** The distance of two aircraft that have lost separation at a row, or the minimum distance if they
 *  had lost it in the cycle before (`within`); null if neither. */
function lossText(plane, scenario, [first, second], row, limits, within) {
  const [one, other] = [scenario.aircraft[first], scenario.aircraft[second]];
  const [from, to] = [one, other].map((each) => [each.xNm[row], each.yNm[row]]);
  const distance = Math.hypot(...plane.offset(from, to));
  const levels = Math.abs(one.fl[row] - other.fl[row]);
  if (distance < limits.nm && levels < limits.fl - SAME_FL) return nmText(distance);
  return within ? `min ${nmText(within.least_nm)}` : null;
}

/**
 * Losses of separation at a row, then predicted ones, the earliest first: the `pair` of aircraft,
 * their positions now (`from`) and when separation is lost (`at`), and a `text` with time and
 * distance. `limits`: distances below `nm` with level differences below `fl` are a loss.
 */
function encountersAt(plane, scenario, row, limits) {
  const shown = scenario.aircraft.map((each) => isFlying(each, row));
  const paths = scenario.aircraft.map((each, index) => shown[index] && projected(plane, each, row));
  const exited = scenario.aircraft.map((each) => statusAt(each, row) === "exited");
  const bounds = boundsOf(paths);
  const limit = planeLimit(plane, bounds, limits.nm);
  const recorded = lossesAt(scenario, row);
  const found = [];
  for (let second = 1; second < paths.length; second++) {
    for (let first = 0; first < second; first++) {
      const [one, other] = [paths[first], paths[second]];
      if (!one || !other) continue;
      const within = recorded.get(first * paths.length + second);
      if (!within && staysApart(bounds[first], bounds[second], limits.fl, limit)) continue;
      const both = { pair: [scenario.aircraft[first], scenario.aircraft[second]] };
      const from = [one.positions[0], other.positions[0]];
      const lost = lossText(plane, scenario, [first, second], row, limits, within);
      if (lost) found.push({ kind: "loss", ...both, from, at: from, seconds: 0, text: lost });
      if (lost || exited[first] || exited[second]) continue;
      const conflict = conflictOf(plane, one, other, limits);
      if (!conflict) continue;
      const text = `in ${minutes(conflict.seconds)}, min ${nmText(conflict.nm)}`;
      found.push({ kind: "conflict", ...both, from, ...conflict, text });
    }
  }
  const lost = (each) => Number(each.kind === "loss");
  return found.sort((one, other) => lost(other) - lost(one) || one.seconds - other.seconds);
}
