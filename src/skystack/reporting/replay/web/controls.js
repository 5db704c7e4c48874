// Buttons, keyboard and pointer, all of which call the player or the view.

const PAN_PX = 60;
const ZOOM_STEP = 1.3;

/** All keys, from which the help is made. `does` describes the action, `run` performs it; `many` marks
 *  those for replays of many scenarios. */
function keysOf(player, view, actions) {
  const size = () => [actions.canvas.clientWidth, actions.canvas.clientHeight];
  const pan = (right, down) => () => view.panBy(right * PAN_PX, down * PAN_PX, ...size());
  const zoom = (factor) => () => view.zoomBy(factor, ...size());
  const number = (key) => player.select(player.callsigns[Number(key) - 1] ?? player.selected);
  return [
    { keys: [" ", "k"], shown: "Space or K", does: player.words.toggle, run: () => player.toggle() },
    { keys: ["ArrowRight"], shown: "→", does: player.words.forward, run: () => player.step(1) },
    { keys: ["ArrowLeft"], shown: "←", does: "one cycle back", run: () => player.step(-1) },
    { keys: [".", "Shift+ArrowRight"], shown: ". or Shift →", does: "next clearance", run: () => player.toClearance(1) },
    { keys: [",", "Shift+ArrowLeft"], shown: ", or Shift ←", does: "previous clearance", run: () => player.toClearance(-1) },
    { keys: ["Home"], shown: "Home", does: "go to the start", run: () => player.step(-player.lastRow) },
    { keys: ["End"], shown: "End", does: player.words.end, run: () => player.step(player.lastRow) },
    { keys: ["]"], shown: "]", does: "faster", run: () => player.faster(1) },
    { keys: ["["], shown: "[", does: "slower", run: () => player.faster(-1) },
    { keys: ["n", "ArrowDown"], shown: "N or ↓", does: "next scenario", many: true, run: () => player.open(player.index + 1) },
    { keys: ["p", "ArrowUp"], shown: "P or ↑", does: "previous scenario", many: true, run: () => player.open(player.index - 1) },
    { keys: [..."123456789"], shown: "1 to 9", does: "select an aircraft", run: number },
    { keys: ["f", "/"], shown: "F or /", does: "find an aircraft by its callsign", run: actions.find },
    { keys: ["Escape"], shown: "Esc", does: "clear the measuring line, then the selection", run: actions.clear },
    { keys: ["m"], shown: "M", does: "measure: drag between two points or aircraft", run: actions.measure },
    { keys: ["g"], shown: "G", does: "show or hide the vertical profile", run: actions.profile },
    { keys: ["+", "="], shown: "+", does: "zoom in", run: zoom(ZOOM_STEP) },
    { keys: ["-"], shown: "-", does: "zoom out", run: zoom(1 / ZOOM_STEP) },
    { keys: ["0"], shown: "0", does: "show the whole sector", run: () => view.fit() },
    { keys: ["w"], shown: "W", does: "move the view up", run: pan(0, 1) },
    { keys: ["s"], shown: "S", does: "move the view down", run: pan(0, -1) },
    { keys: ["a"], shown: "A", does: "move the view left", run: pan(1, 0) },
    { keys: ["d"], shown: "D", does: "move the view right", run: pan(-1, 0) },
    { keys: ["r"], shown: "R", does: "separation rings: all aircraft, or only conflicts and the selection", run: actions.rings },
    { keys: ["v"], shown: "V", does: "vector length: 1, 2 or 5 minutes", run: actions.vector },
    { keys: ["h"], shown: "H", does: "trail length", run: actions.trail },
    { keys: ["o"], shown: "O", does: "options: vectors, trails, levels, downloads", run: actions.options },
    { keys: ["i"], shown: "I", does: "download the picture as PNG", run: actions.picture },
    { keys: ["c"], shown: "C", does: "download the clearances of this scenario as CSV", run: actions.csv },
    { keys: ["t"], shown: "T", does: "light or dark theme", run: actions.theme },
    { keys: ["l"], shown: "L", does: "copy a link to this scenario and time", run: actions.link },
    { keys: ["?"], shown: "?", does: "show this help", run: actions.help },
  ];
}

/** Whether the focused element handles the key itself. */
function keepsKey(target, key) {
  if (target.closest("select, dialog, input:not([type=range], [type=checkbox])")) return true;
  return Boolean(target.closest("button, [type=checkbox]")) && (key === " " || key === "Enter");
}

function listenToKeys(keys) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || keepsKey(event.target, event.key)) return;
    const letter = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const name = event.shiftKey && letter.startsWith("Arrow") ? `Shift+${letter}` : letter;
    const found = keys.find((each) => each.keys.includes(name));
    if (!found) return;
    event.preventDefault();
    found.run(letter);
  });
}

// After a click, buttons lose the focus, so that Space and Enter work as shortcuts again.
document.addEventListener("click", (event) => {
  if (event.detail) event.target.closest("button")?.blur();
});

/** Connects each button to its key, which the tooltip names. */
function wireButtons(keys) {
  for (const button of document.querySelectorAll("button[data-key]")) {
    const { shown, does, run } = keys.find((each) => each.keys.includes(button.dataset.key));
    button.title = `${does} (${shown})`;
    button.setAttribute("aria-label", does);
    button.addEventListener("click", () => run(button.dataset.key));
  }
}

function fillHelp(list, keys) {
  for (const { shown, does } of keys) {
    const group = element("div");
    const term = element("dt");
    term.append(element("kbd", "", shown));
    group.append(term, element("dd", "", does));
    list.append(group);
  }
}

/** Drag pans or measures, wheel or two fingers zoom, click selects. */
function listenToPointer(scope, player, view, display, measure) {
  const { canvas } = scope;
  const held = new Map();
  let moved = 0;
  const size = () => [canvas.clientWidth, canvas.clientHeight];
  const position = (event) => [event.offsetX, event.offsetY];
  const spread = () => {
    const [one, other] = [...held.values()];
    return other ? Math.hypot(one[0] - other[0], one[1] - other[1]) : 0;
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (!held.size) moved = 0;
    held.set(event.pointerId, position(event));
    if (display.measuring && held.size === 1) measure.from(scope.endAt(position(event)));
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const [now, apart] = [position(event), spread()];
    const [right, down] = [now[0] - before[0], now[1] - before[1]];
    held.set(event.pointerId, now);
    moved += Math.hypot(right, down);
    if (display.measuring && held.size === 1) {
      measure.to(scope.endAt(now));
      return;
    }
    view.panBy(right / held.size, down / held.size, ...size());
    if (apart) view.zoomBy(spread() / apart, ...size(), middle([...held.values()]));
  });
  canvas.addEventListener("pointerup", (event) => {
    if (held.size !== 1 || moved >= 6 || display.measuring) return;
    const callsign = scope.hit(...position(event));
    if (callsign !== null) player.pick(callsign, event.shiftKey);
    else if (!event.shiftKey) player.select(null);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => held.delete(event.pointerId));
  }
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      view.zoomBy(Math.exp(-event.deltaY / 500), ...size(), position(event));
    },
    { passive: false },
  );
}

function middle([one, other]) {
  return [(one[0] + other[0]) / 2, (one[1] + other[1]) / 2];
}
