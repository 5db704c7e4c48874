// Who loses separation, and who would on present tracks.

const LOOK_AHEAD_S = 600;

function motion(aircraft, row) {
  const speedNmS = aircraft.speedKt[row] / 3600;
  const heading = (aircraft.headingDeg[row] * Math.PI) / 180;
  return {
    x: aircraft.xNm[row],
    y: aircraft.yNm[row],
    vx: speedNmS * Math.sin(heading),
    vy: speedNmS * Math.cos(heading),
  };
}

/** Least distance of two that keep track and speed, when, and where both are then. */
function closestApproach(one, other) {
  const [x, y] = [other.x - one.x, other.y - one.y];
  const [vx, vy] = [other.vx - one.vx, other.vy - one.vy];
  const square = vx * vx + vy * vy;
  const seconds = square > 0 ? Math.max(0, -(x * vx + y * vy) / square) : 0;
  const then = (each) => [each.x + each.vx * seconds, each.y + each.vy * seconds];
  return {
    nm: Math.hypot(x + vx * seconds, y + vy * seconds),
    seconds,
    at: [then(one), then(other)],
  };
}

/** How far apart the levels are that two may pass on their way to what they are cleared to. */
function levelsBetween(one, other, row) {
  const [low, high] = [Math.min, Math.max].map((end) =>
    [one, other].map((each) => end(each.fl[row], each.clearedFl[row])),
  );
  return Math.max(low[0] - high[1], low[1] - high[0], 0);
}

function isLost(scenario, first, second, row, limits) {
  const [one, other] = [scenario.aircraft[first], scenario.aircraft[second]];
  const distance = Math.hypot(one.xNm[row] - other.xNm[row], one.yNm[row] - other.yNm[row]);
  const now = distance < limits.nm && Math.abs(one.fl[row] - other.fl[row]) < limits.fl;
  // The rows hold the ends of a cycle; what happened within it stands in the losses.
  const within = scenario.losses.some(
    (loss) =>
      loss.first === first && loss.second === second && loss.begins < row && row <= loss.ends,
  );
  return { lost: now || within, distance };
}

function encounter(scenario, first, second, row, limits) {
  const pair = [scenario.aircraft[first], scenario.aircraft[second]];
  if (pair.some((each) => row >= each.rows)) return null;
  const from = pair.map((each) => [each.xNm[row], each.yNm[row]]);
  const { lost, distance } = isLost(scenario, first, second, row, limits);
  if (lost) return { kind: "loss", pair, from, at: from, text: `${distance.toFixed(1)} NM` };
  if (pair.some((each) => statusAt(each, row) === "exited")) return null;
  if (levelsBetween(...pair, row) >= limits.fl) return null;
  const approach = closestApproach(...pair.map((each) => motion(each, row)));
  if (approach.nm >= limits.nm || approach.seconds > LOOK_AHEAD_S) return null;
  const text = `${approach.nm.toFixed(1)} NM in ${minutes(approach.seconds)}`;
  return { kind: "conflict", pair, from, at: approach.at, text };
}

/**
 * Losses of separation and predicted ones at a row, the losses first: the `pair` of aircraft,
 * `from` where they are, `at` where they will be closest, `text` how close and when.
 */
function encountersAt(scenario, row, limits) {
  const found = [];
  for (let second = 1; second < scenario.aircraft.length; second++) {
    for (let first = 0; first < second; first++) {
      const met = encounter(scenario, first, second, row, limits);
      if (met) found.push(met);
    }
  }
  return found.sort((one, other) => (one.kind < other.kind) - (one.kind > other.kind));
}
