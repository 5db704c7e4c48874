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

/** One decimal, rounded down: 4.99 NM is no 5.0. */
function nmText(nm) {
  return `${(Math.floor(nm * 10 + 1e-6) / 10).toFixed(1)} NM`;
}

/** How close two are that have lost separation at a row or in the cycle before it, else null. */
function lossText(scenario, first, second, row, limits) {
  const [one, other] = [scenario.aircraft[first], scenario.aircraft[second]];
  const distance = Math.hypot(one.xNm[row] - other.xNm[row], one.yNm[row] - other.yNm[row]);
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
  if (levelsBetween(...pair, row) >= limits.fl) return null;
  const { nm, seconds, at } = closestApproach(...pair.map((each) => motion(each, row)));
  if (nm >= limits.nm || seconds > LOOK_AHEAD_S) return null;
  const text = `${nmText(nm)} in ${minutes(seconds)}`;
  return { kind: "conflict", pair, from, at, seconds, text };
}

/**
 * Losses of separation at a row, then predicted ones, the soonest first: the `pair` of aircraft,
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
  const lost = (each) => Number(each.kind === "loss");
  return found.sort((one, other) => lost(other) - lost(one) || one.seconds - other.seconds);
}
