// Data blocks: their text, and their placement without overlaps.

const BLOCK_LINE_PX = 14;
const LETTER_PX = 7.25;
const SLOTS = [16, 44, 78].flatMap((far) =>
  [[1, -1], [1, 1], [-1, -1], [-1, 1], [1, 0], [-1, 0], [0, 1], [0, -1]].map(([right, down]) => ({
    right,
    down,
    far,
  })),
);
const STAY = 60; // the gain for which a block moves to another slot, in square pixels covered

function blockLines(aircraft, row) {
  const speed = String(Math.round(aircraft.speedKt[row]));
  return [
    aircraft.callsign,
    levelText(aircraft, row),
    `${speed} H${threeDigits(aircraft.clearedHeadingDeg[row])}`,
    ...(statusAt(aircraft, row) === "excursion" ? ["EXCURSION"] : []),
  ];
}

const FILL = 0.3; // the part of the picture that blocks may cover

/** Shortens blocks until they cover at most a part of a picture: callsign, level and speed; callsign
 *  and level; callsign. Those with `least` lines keep them. Returns the number of lines. */
function shorten(blocks, picturePx) {
  for (const most of [4, 2, 1]) {
    const cut = ({ lines, least }) => lines.slice(0, Math.max(most, least));
    const covered = blocks.reduce((sum, block) => {
      const { width, height } = sizeOf(cut(block));
      return sum + width * height;
    }, 0);
    if (covered > FILL * picturePx && most > 1) continue;
    for (const block of blocks) {
      block.lines = cut(block);
      Object.assign(block, sizeOf(block.lines));
    }
    return most;
  }
}

function sizeOf(lines) {
  const letters = Math.max(...lines.map((line) => [...line].length));
  return { width: letters * LETTER_PX + 4, height: lines.length * BLOCK_LINE_PX };
}

function boxIn(slot, [x, y], width, height) {
  const along = (side, size) => (side > 0 ? 0 : side < 0 ? -size : -size / 2);
  return {
    left: x + slot.right * slot.far + along(slot.right, width),
    top: y + (slot.down * slot.far) / (slot.right ? 1.6 : 1) + along(slot.down, height),
    width,
    height,
  };
}

function overlap(one, other) {
  const right = Math.min(one.left + one.width, other.left + other.width);
  const across = right - Math.max(one.left, other.left);
  if (across <= 0) return 0;
  const bottom = Math.min(one.top + one.height, other.top + other.height);
  return across * Math.max(0, bottom - Math.max(one.top, other.top));
}

const CELL_PX = 64;

/** Boxes in the cells of a grid, so that only those nearby are compared. */
class Boxes {
  constructor() {
    this.all = [];
    this.cells = new Map();
  }

  add(box) {
    this.all.push(box);
    for (const cell of cellsOf(box)) {
      if (!this.cells.has(cell)) this.cells.set(cell, []);
      this.cells.get(cell).push(this.all.length - 1);
    }
  }

  /** The boxes that may overlap a box, in the order in which they were added. */
  near(box) {
    const found = new Set(cellsOf(box).flatMap((cell) => this.cells.get(cell) ?? []));
    const inOrder = [...found].sort((one, other) => one - other);
    return inOrder.map((number) => this.all[number]).filter((each) => overlap(each, box) > 0);
  }
}

function cellsOf({ left, top, width, height }) {
  const cell = (pixels) => Math.floor(pixels / CELL_PX);
  const cells = [];
  for (let row = cell(top); row <= cell(top + height); row++) {
    for (let column = cell(left); column <= cell(left + width); column++) {
      cells.push(row * 1e6 + column);
    }
  }
  return cells;
}

/** The box that contains all slots of a block. */
function reachOf({ at: [x, y], width, height }) {
  const far = SLOTS[SLOTS.length - 1].far;
  const [across, up] = [far + width, far + height];
  return { left: x - across, top: y - up, width: 2 * across, height: 2 * up };
}

const around = ([x, y], reach) => ({
  left: x - reach,
  top: y - reach,
  width: 2 * reach,
  height: 2 * reach,
});

/**
 * Chooses a slot for every block, `{at, ahead, width, height, slot}`, in the order given: the slot
 * that covers least of the earlier blocks, the aircraft, the points ahead of them, and `keepFree`.
 */
function chooseSlots(blocks, keepFree, canvas) {
  const taken = new Boxes();
  for (const box of keepFree) taken.add(box);
  for (const block of blocks) {
    for (const box of [around(block.at, 12), ...block.ahead.map((point) => around(point, 6))]) {
      taken.add(box);
    }
  }
  for (const block of blocks) {
    const near = taken.near(reachOf(block));
    const cost = (slot, index) => {
      const box = boxIn(slot, block.at, block.width, block.height);
      const outside = box.width * box.height - overlap(box, canvas);
      const covered = near.reduce((sum, other) => sum + overlap(box, other), 0);
      return covered + 3 * outside + index + slot.far - (index === block.slot ? STAY : 0);
    };
    const costs = SLOTS.map(cost);
    block.slot = costs.indexOf(Math.min(...costs));
    taken.add(boxIn(SLOTS[block.slot], block.at, block.width, block.height));
  }
}
