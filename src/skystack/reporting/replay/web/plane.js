// The Mercator plane of the picture. North is up; lengths are true lengths times a local scale.

class Plane {
  /** `coefficients` of the scale as a polynomial in y / `range_nm`, constant term first. */
  constructor({ coefficients, range_nm }) {
    this.coefficients = coefficients;
    this.rangeNm = range_nm;
  }

  /** Plane length per true length at the plane distance y north of the origin. */
  scale(y) {
    const reduced = Math.min(Math.max(y / this.rangeNm, -1), 1);
    return this.coefficients.reduceRight((value, each) => value * reduced + each, 0);
  }

  /** The offset from one position to another in true NM east and north. */
  offset([x, y], [toX, toY]) {
    const scale = this.scale((y + toY) / 2);
    return [(toX - x) / scale, (toY - y) / scale];
  }

  /** The true length of the line of constant heading between two positions (Simpson's rule). */
  lengthNm([x, y], [toX, toY]) {
    const [start, middle, end] = [y, (y + toY) / 2, toY].map((each) => 1 / this.scale(each));
    return (Math.hypot(toX - x, toY - y) * (start + 4 * middle + end)) / 6;
  }

  /** The position reached on a heading after a true distance, using the scale half-way. */
  reached([x, y], degrees, nm) {
    const angle = (degrees * Math.PI) / 180;
    const halfWay = y + (this.scale(y) * Math.cos(angle) * nm) / 2;
    const length = this.scale(halfWay) * nm;
    return [x + length * Math.sin(angle), y + length * Math.cos(angle)];
  }
}
