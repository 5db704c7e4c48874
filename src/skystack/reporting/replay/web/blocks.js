// Data blocks: their text, and their placement without overlaps.

const BLOCK_LINE_PX = 14;
const SLOTS = [16, 44].flatMap((far) =>
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
  const side = (start, size) =>
    Math.min(one[start] + one[size], other[start] + other[size]) -
    Math.max(one[start], other[start]);
  return Math.max(0, side("left", "width")) * Math.max(0, side("top", "height"));
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
  const taken = [...keepFree];
  for (const block of blocks) {
    taken.push(around(block.at, 12), ...block.ahead.map((point) => around(point, 6)));
  }
  for (const block of blocks) {
    const cost = (slot, index) => {
      const box = boxIn(slot, block.at, block.width, block.height);
      const outside = box.width * box.height - overlap(box, canvas);
      const covered = taken.reduce((sum, other) => sum + overlap(box, other), 0);
      return covered + 3 * outside + index + slot.far - (index === block.slot ? STAY : 0);
    };
    const costs = SLOTS.map(cost);
    block.slot = costs.indexOf(Math.min(...costs));
    taken.push(boxIn(SLOTS[block.slot], block.at, block.width, block.height));
  }
}
