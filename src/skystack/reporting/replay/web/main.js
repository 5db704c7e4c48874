// Builds the page and keeps it in step with the player and the address.

const replay = JSON.parse(document.getElementById("recorded").textContent);
const view = new View(replay.sector);
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const light = matchMedia("(prefers-color-scheme: light)");
const look = document.documentElement.dataset;
const byId = (id) => document.getElementById(id);

let rings = true;
const player = new Player(replay, changed);
const panes = replay.runs.map((run) => makePane(run.title));
const timeline = new Timeline(player);

function makePane(title) {
  const pane = byId("pane").content.firstElementChild.cloneNode(true);
  byId("panes").append(pane);
  const scope = new Scope(pane.querySelector("canvas"), replay, view);
  listenToPointer(scope, player, view);
  return { scope, panels: new Panels(pane, title, player) };
}

function changed(what) {
  if (what === "scenario") {
    panes.forEach(({ panels }, index) => panels.open(player.runs[index]));
    timeline.open();
    byId("scenario").value = String(player.index);
  } else if (what === "playing") {
    document.body.classList.toggle("playing", player.playing);
    byId("speed").value = String(player.speed);
  } else {
    panes.forEach(({ scope, panels }, index) => {
      panels.show(player.row, scope.show(player.runs[index], player.row));
    });
    timeline.show();
    if (what === "selection") panes.forEach(({ panels }) => panels.reveal(player.selected));
  }
  updateAddressSoon();
}

// The address has scenario, cycle and selection. Browsers block pages that change it too often.

let addressTimer = 0;

function updateAddressSoon() {
  clearTimeout(addressTimer);
  if (!player.playing) addressTimer = setTimeout(updateAddress, 150);
}

function updateAddress() {
  const state = new URLSearchParams({ scenario: player.packed.number, cycle: player.row });
  if (player.selected !== null) state.set("aircraft", player.selected);
  history.replaceState(null, "", `#${state}`);
}

function openAddress() {
  const state = new URLSearchParams(location.hash.slice(1));
  const wanted = Number(state.get("scenario") ?? NaN);
  const index = replay.runs[0].scenarios.findIndex((each) => each.number === wanted);
  if (state.has("scenario") && index < 0) notify(`There is no scenario ${state.get("scenario")}.`);
  player.play(false);
  player.selected = state.get("aircraft");
  player.open(Math.max(index, 0), index < 0 ? 0 : Math.trunc(Number(state.get("cycle"))) || 0);
}

function notify(message) {
  byId("told").textContent = message;
  setTimeout(() => (byId("told").textContent = ""), 4000);
}

async function copyLink() {
  updateAddress();
  try {
    await navigator.clipboard.writeText(location.href);
    notify("Link copied.");
  } catch {
    notify("The link to this moment is in the address bar.");
  }
}

function fillScenarios() {
  replay.runs[0].scenarios.forEach(({ number }, index) => {
    const flown = replay.runs.map((run) => run.scenarios[index]);
    const counts = flown.map((each) => each.clearances.length).join(" and ");
    const lost = flown.some((each) => each.losses.length) ? ", loss of separation" : "";
    const failed = flown.some((each) => each.success === false) ? ", no success" : "";
    const noun = counts === "1" ? "clearance" : "clearances";
    byId("scenario").add(new Option(`${number}: ${counts} ${noun}${lost}${failed}`, String(index)));
  });
  for (const speed of SPEEDS) byId("speed").add(new Option(`${speed}×`, String(speed)));
}

let before = 0;
let drawn = "";

function frame(now) {
  player.tick(Math.min(now - before, 250)); // a page in the background pauses
  before = now;
  const part = player.speed <= SMOOTH_UP_TO && !calm.matches ? player.elapsed : 0;
  const { index, row, selected } = player;
  const sizes = panes.map(({ scope: { canvas } }) => [canvas.clientWidth, canvas.clientHeight]);
  const seen = [view.zoom, view.centre, sizes, look.theme, devicePixelRatio];
  const wanted = JSON.stringify([index, row, part, selected, rings, seen]);
  if (wanted !== drawn) {
    for (const { scope } of panes) scope.draw(part, selected, rings);
  }
  drawn = wanted;
  requestAnimationFrame(frame);
}

const keys = keysOf(player, view, {
  canvas: panes[0].scope.canvas,
  rings: () => (rings = !rings),
  theme: () => (look.theme = look.theme === "light" ? "dark" : "light"),
  link: copyLink,
  help: () => byId("help").showModal(),
});
listenToKeys(keys);
wireButtons(keys);
fillHelp(byId("keys"), keys);
fillScenarios();
byId("panes").classList.toggle("two", panes.length > 1);
byId("scenario").addEventListener("change", (event) => player.open(Number(event.target.value)));
byId("speed").addEventListener("change", (event) => player.faster(
  SPEEDS.indexOf(Number(event.target.value)) - SPEEDS.indexOf(player.speed),
));
const followSystemTheme = () => (look.theme = light.matches ? "light" : "dark");
light.addEventListener("change", followSystemTheme);
followSystemTheme();
addEventListener("hashchange", openAddress);
openAddress();
player.faster(0);
requestAnimationFrame(frame);
