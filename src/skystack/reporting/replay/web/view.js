// The visible part of the plane. All radars share one view, so that they stay aligned.

const MIN_ZOOM = 0.5;
const MAX_ZOOM = 16;

class View {
  constructor(sector) {
    const points = [...sector.area, ...Object.values(sector.fixes)];
    const [xs, ys] = [0, 1].map((axis) => points.map((point) => point[axis]));
    this.low = [Math.min(...xs), Math.min(...ys)];
    this.high = [Math.max(...xs), Math.max(...ys)];
    this.fit();
  }

  fit() {
    this.zoom = 1;
    this.centre = [0, 1].map((axis) => (this.low[axis] + this.high[axis]) / 2);
  }

  /** Pixels per NM of the plane, which is a true NM only at the origin. */
  pixelsPerNm(width, height) {
    const [marginX, marginY] = [Math.min(56, width / 9), Math.min(40, height / 9)];
    const across = (width - 2 * marginX) / (this.high[0] - this.low[0]);
    const up = (height - 2 * marginY) / (this.high[1] - this.low[1]);
    return Math.max(Math.min(across, up), 0.1) * this.zoom;
  }

  /** A function that turns a point of the plane into pixels. */
  toPixels(width, height) {
    const scale = this.pixelsPerNm(width, height);
    const [x0, y0] = this.centre;
    return (x, y) => [width / 2 + (x - x0) * scale, height / 2 - (y - y0) * scale];
  }

  /** The inverse of `toPixels`. */
  toPlane(width, height) {
    const scale = this.pixelsPerNm(width, height);
    const [x0, y0] = this.centre;
    return (x, y) => [x0 + (x - width / 2) / scale, y0 - (y - height / 2) / scale];
  }

  /** Shows positions that are out of the picture: moves the view, and zooms out if necessary. */
  reveal(positions, width, height) {
    const at = this.toPixels(width, height);
    const isIn = ([x, y]) => x > 0 && x < width && y > 0 && y < height;
    if (positions.every(([x, y]) => isIn(at(x, y)))) return;
    const ends = [0, 1].map((axis) => positions.map((position) => position[axis]));
    this.centre = ends.map((values) => (Math.min(...values) + Math.max(...values)) / 2);
    const spans = ends.map((values) => Math.max(...values) - Math.min(...values));
    const scale = this.pixelsPerNm(width, height);
    const fill = Math.max((spans[0] * scale) / width, (spans[1] * scale) / height) / 0.8;
    if (fill > 1) this.zoom = Math.max(this.zoom / fill, MIN_ZOOM);
  }

  panBy(right, down, width, height) {
    const scale = this.pixelsPerNm(width, height);
    const moved = [this.centre[0] - right / scale, this.centre[1] + down / scale];
    this.centre = moved.map((at, axis) =>
      Math.min(Math.max(at, this.low[axis]), this.high[axis]),
    );
  }

  /** Zooms about a point of the picture (default: its centre), which stays in place. */
  zoomBy(factor, width, height, [x, y] = [width / 2, height / 2]) {
    const before = this.zoom;
    this.zoom = Math.min(Math.max(before * factor, MIN_ZOOM), MAX_ZOOM);
    const grown = this.zoom / before;
    this.panBy((width / 2 - x) * (grown - 1), (height / 2 - y) * (grown - 1), width, height);
  }
}
