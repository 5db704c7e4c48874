// The plane of the picture: north is up everywhere, but lengths are true lengths times a local scale.

class Plane {
  /** `coefficients` of the scale as a polynomial in y / `range_nm`, the constant one first. */
  constructor({ coefficients, range_nm }) {
    this.coefficients = coefficients;
    this.rangeNm = range_nm;
  }

  /** Plane length per true length at a distance north of the origin. */
  scale(y) {
    const reduced = Math.min(Math.max(y / this.rangeNm, -1), 1);
    return this.coefficients.reduceRight((value, each) => value * reduced + each, 0);
  }

  /** From one place to another, as true NM east and north. */
  offset([x, y], [toX, toY]) {
    const scale = this.scale((y + toY) / 2);
    return [(toX - x) / scale, (toY - y) / scale];
  }

  /** The place reached on a heading after a true distance: at the scale half-way. */
  reached([x, y], degrees, nm) {
    const angle = (degrees * Math.PI) / 180;
    const halfWay = y + (this.scale(y) * Math.cos(angle) * nm) / 2;
    const length = this.scale(halfWay) * nm;
    return [x + length * Math.sin(angle), y + length * Math.cos(angle)];
  }
}
