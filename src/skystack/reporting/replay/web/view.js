// The visible part of the plane. All radars share one view, so that they stay aligned.

const ZOOM_LEAST = 0.5;
const ZOOM_MOST = 16;

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
    this.zoom = Math.min(Math.max(before * factor, ZOOM_LEAST), ZOOM_MOST);
    const grown = this.zoom / before;
    this.panBy((width / 2 - x) * (grown - 1), (height / 2 - y) * (grown - 1), width, height);
  }
}
