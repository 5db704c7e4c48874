// Which aircraft lose separation, and which would on present tracks.

const LOOK_AHEAD_S = 600;

/** Where an aircraft is, and how it goes on: straight ahead, and on to its cleared level. */
function motion(aircraft, row) {
  const speedNmS = aircraft.speedKt[row] / 3600;
  const heading = (aircraft.headingDeg[row] * Math.PI) / 180;
  const toGo = aircraft.clearedFl[row] - aircraft.fl[row];
  // An aircraft that has only just been cleared does not climb yet.
  const rate = Math.abs(aircraft.climbFtMin[row]) || aircraft.usualClimbFtMin;
  const climbFlS = (Math.sign(toGo) * rate) / 100 / 60;
  return {
    x: aircraft.xNm[row],
    y: aircraft.yNm[row],
    vx: speedNmS * Math.sin(heading), // true, not in the plane
    vy: speedNmS * Math.cos(heading),
    fl: aircraft.fl[row],
    climbFlS,
    levelAfterS: toGo === 0 ? 0 : toGo / climbFlS,
  };
}

/** Of the second from the first, in true NM: the plane's lengths are divided by its scale. */
function relative(one, other, scale) {
  const nm = 1 / scale((one.y + other.y) / 2);
  return {
    x: (other.x - one.x) * nm,
    y: (other.y - one.y) * nm,
    vx: other.vx - one.vx,
    vy: other.vy - one.vy,
  };
}

/** The span of time [s], from below zero on, in which two are closer than a limit, or null. */
function closeSpan({ x, y, vx, vy }, nm) {
  const [a, b, c] = [vx * vx + vy * vy, x * vx + y * vy, x * x + y * y - nm * nm];
  if (a === 0) return c < 0 ? [-Infinity, Infinity] : null;
  const root = b * b - a * c;
  if (root <= 0) return null;
  return [(-b - Math.sqrt(root)) / a, (-b + Math.sqrt(root)) / a];
}

function levelAt(each, seconds) {
  return each.fl + each.climbFlS * Math.min(seconds, each.levelAfterS);
}

/** The spans of time in which two are vertically closer than a limit, in order. */
function levelSpans(one, other, fl) {
  const ends = [0, one.levelAfterS, other.levelAfterS, Infinity].sort((a, b) => a - b);
  const spans = [];
  for (let piece = 0; piece < 3; piece++) {
    const [from, to] = [ends[piece], ends[piece + 1]];
    if (from === to) continue;
    const gap = levelAt(other, from) - levelAt(one, from);
    const rate = (each) => (from < each.levelAfterS ? each.climbFlS : 0);
    const climb = rate(other) - rate(one);
    if (climb === 0) {
      if (Math.abs(gap) < fl) spans.push([from, to]);
      continue;
    }
    const [low, high] = [(-fl - gap) / climb, (fl - gap) / climb].sort((a, b) => a - b);
    const span = [Math.max(from, from + low), Math.min(to, from + high)];
    if (span[0] < span[1]) spans.push(span);
  }
  return spans;
}

/**
 * The loss of separation that two are flying into: `seconds` until it begins, `at`, where both are
 * then, and the least distance `nm` in it; null without one.
 */
function predictedLoss(one, other, limits) {
  const offset = relative(one, other, limits.scale);
  const close = closeSpan(offset, limits.nm);
  if (close === null) return null;
  const spans = levelSpans(one, other, limits.fl)
    .map(([from, to]) => [Math.max(from, close[0]), Math.min(to, close[1])])
    .filter(([from, to]) => from < to);
  if (spans.length === 0) return null;
  const square = offset.vx ** 2 + offset.vy ** 2;
  const nearest = square > 0 ? -(offset.x * offset.vx + offset.y * offset.vy) / square : 0;
  const distance = (t) => Math.hypot(offset.x + offset.vx * t, offset.y + offset.vy * t);
  const nm = Math.min(
    ...spans.map(([from, to]) => distance(Math.min(Math.max(nearest, from), to))),
  );
  const seconds = spans[0][0];
  const then = (each) => {
    const plane = limits.scale(each.y) * seconds;
    return [each.x + each.vx * plane, each.y + each.vy * plane];
  };
  return { seconds, nm, at: [then(one), then(other)] };
}

/** One decimal, rounded down: 4.99 NM is no 5.0. */
function nmText(nm) {
  return `${(Math.floor(nm * 10 + 1e-6) / 10).toFixed(1)} NM`;
}

/** How close two are that have lost separation at a row or in the cycle before it, else null. */
function lossText(scenario, first, second, row, limits) {
  const [one, other] = [scenario.aircraft[first], scenario.aircraft[second]];
  const middle = (one.yNm[row] + other.yNm[row]) / 2;
  const plane = Math.hypot(one.xNm[row] - other.xNm[row], one.yNm[row] - other.yNm[row]);
  const distance = plane / limits.scale(middle);
  const levels = Math.abs(one.fl[row] - other.fl[row]);
  if (distance < limits.nm && levels < limits.fl) return nmText(distance);
  const within = scenario.losses.find(
    (loss) =>
      loss.first === first && loss.second === second && loss.begins < row && row <= loss.ends,
  );
  return within ? `least ${nmText(within.least_nm)}` : null;
}

function encounter(scenario, first, second, row, limits) {
  const pair = [scenario.aircraft[first], scenario.aircraft[second]];
  if (pair.some((each) => row >= each.rows)) return null;
  const from = pair.map((each) => [each.xNm[row], each.yNm[row]]);
  const lost = lossText(scenario, first, second, row, limits);
  if (lost) return { kind: "loss", pair, from, at: from, seconds: 0, text: lost };
  if (pair.some((each) => statusAt(each, row) === "exited")) return null;
  const ahead = predictedLoss(...pair.map((each) => motion(each, row)), limits);
  if (ahead === null || ahead.seconds > LOOK_AHEAD_S) return null;
  const { seconds, at } = ahead;
  const text = `in ${minutes(seconds)}, least ${nmText(ahead.nm)}`;
  return { kind: "conflict", pair, from, at, seconds, text };
}

/**
 * Losses of separation at a row, then predicted ones, the soonest first: the `pair` of aircraft,
 * `from` where they are, `at` where they will lose it, `text` how close and when.
 */
function encountersAt(scenario, row, limits) {
  const found = [];
  for (let second = 1; second < scenario.aircraft.length; second++) {
    for (let first = 0; first < second; first++) {
      const met = encounter(scenario, first, second, row, limits);
      if (met) found.push(met);
    }
  }
  const lost = (each) => Number(each.kind === "loss");
  return found.sort((one, other) => lost(other) - lost(one) || one.seconds - other.seconds);
}
