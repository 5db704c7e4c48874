// Which pairs cannot lose separation: a cheap bound, so that few of many pairs are followed closely.

const BOUND_PIECES = LOOK_AHEAD_S / PIECE_S + 1; // a loss begins in these, or is not predicted
const SCALE_MARGIN = 1.001; // the scale is a polynomial close to a convex function

/** What the bound needs of each path: an aircraft flies straight in the plane, at a speed that changes
 *  with the scale, so its position is within `off` of one at the mean velocity `v` per piece. */
function boundsOf(paths) {
  return paths.map((path) => {
    if (!path) return null;
    const [start, end] = [path.positions[0], path.positions[BOUND_PIECES]];
    const v = [0, 1].map((axis) => (end[axis] - start[axis]) / BOUND_PIECES);
    let off = 0;
    for (let piece = 1; piece < BOUND_PIECES; piece++) {
      const [x, y] = path.positions[piece];
      off = Math.max(off, Math.hypot(x - start[0] - piece * v[0], y - start[1] - piece * v[1]));
    }
    const [fl, clearedFl] = [path.fl, path.clearedFl];
    return {
      ...{ x: start[0], y: start[1], vx: v[0], vy: v[1], off, endY: end[1] },
      lowFl: Math.min(fl, clearedFl),
      highFl: Math.max(fl, clearedFl),
    };
  });
}

/** A distance in the plane that two aircraft at the limit are never above, on any of the paths. */
function planeLimit(plane, bounds, limitNm) {
  const ys = bounds.flatMap((each) => (each ? [each.y, each.endY] : []));
  if (!ys.length) return 0;
  const scales = [Math.min(...ys), Math.max(...ys)].map((y) => plane.scale(y));
  return limitNm * Math.max(...scales) * SCALE_MARGIN;
}

/** Whether two aircraft certainly neither have lost separation nor are predicted to in time. */
function staysApart(one, other, limitFl, limit) {
  if (one.lowFl - other.highFl >= limitFl || other.lowFl - one.highFl >= limitFl) return true;
  const [x, y, vx, vy] = [other.x - one.x, other.y - one.y, other.vx - one.vx, other.vy - one.vy];
  const square = vx * vx + vy * vy;
  const nearest = square > 0 ? -(x * vx + y * vy) / square : 0;
  const piece = Math.min(Math.max(nearest, 0), BOUND_PIECES);
  const [nearX, nearY] = [x + piece * vx, y + piece * vy];
  const reach = limit + one.off + other.off + 1e-6;
  return nearX * nearX + nearY * nearY > reach * reach;
}
