// Builds the page and keeps it in step with the player and the address.

const replay = JSON.parse(document.getElementById("recorded").textContent);
const view = new View(replay.sector);
const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
const prefersLight = matchMedia("(prefers-color-scheme: light)");
const look = document.documentElement.dataset;
const byId = (id) => document.getElementById(id);

const display = new Display(replay);
const measure = new Measure();
const player = replay.live ? new LivePlayer(replay, changed) : new Player(replay, changed);
const panes = replay.runs.map((run) => makePane(run.title));
const timeline = new Timeline(player);
const { plane, limits } = panes[0].scope;
const scan = new Scan(plane, limits, (lane, span) => timeline.addConflict(lane, span));
const options = new Options(player, display, refresh);

function makePane(title) {
  const pane = byId("pane").content.firstElementChild.cloneNode(true);
  byId("panes").append(pane);
  const scope = new Scope(pane.querySelector(".scope canvas"), replay, view);
  listenToPointer(scope, player, view, display, measure);
  const alerts = new Alerts(pane, player, (pair, row) => goToPair(scope, pair, row));
  const [panels, profile] = [new Panels(pane, title, player), new Profile(pane, player)];
  return { scope, panels, alerts, profile };
}

/** Selects a pair of aircraft and shows them, at a row if one is given. */
function goToPair(scope, pair, row) {
  player.play(false);
  if (row !== undefined) player.goTo(row);
  player.select(...pair);
  const { clientWidth: width, clientHeight: height } = scope.canvas;
  const shown = scope.flying.filter((each) => pair.includes(each.callsign));
  view.reveal(shown.map((each) => positionOf(each, player.row, 0)), width, height);
}

/** Shows the present row again, after a change of the selection or the display. */
function refresh() {
  panes.forEach(({ scope, panels, alerts, profile }, index) => {
    const run = player.runs[index];
    alerts.show(scope.show(run, player.row));
    panels.show(player.row, (aircraft) => scope.isShown(aircraft, player, display));
    profile.show(run, player.row, display.profile);
  });
}

function changed(what) {
  if (what === "scenario") {
    measure.clear();
    panes.forEach(({ panels, alerts }, index) => {
      panels.open(player.runs[index]);
      alerts.open(player.runs[index]);
    });
    timeline.open();
    if (!replay.live) scan.open(player.runs);
    options.open();
    byId("scenario").value = String(player.index);
  } else if (what === "playing") {
    document.body.classList.toggle("playing", player.isMoving);
    byId("speed").value = String(player.speed);
  } else {
    refresh();
    timeline.show();
    if (what === "selection") panes.forEach(({ panels }) => panels.reveal(player.selected));
  }
  updateAddressSoon();
}

// The address has scenario, cycle and selection. Browsers block pages that change it too often.

let addressTimer = 0;

function updateAddressSoon() {
  clearTimeout(addressTimer);
  if (!player.isMoving) addressTimer = setTimeout(updateAddress, 150);
}

function updateAddress() {
  clearTimeout(addressTimer);
  const state = new URLSearchParams({ scenario: player.packed.number, cycle: player.row });
  for (const each of [player.selected, player.partner]) {
    if (each !== null) state.append("aircraft", each);
  }
  history.replaceState(null, "", `#${state}`);
}

function openAddress(address) {
  const state = new URLSearchParams(new URL(address).hash.slice(1));
  const wanted = Number(state.get("scenario") ?? NaN);
  const index = replay.runs[0].scenarios.findIndex((each) => each.number === wanted);
  if (state.has("scenario") && index < 0) notify(`There is no scenario ${state.get("scenario")}.`);
  player.play(false);
  const [selected = null, partner = null] = state.getAll("aircraft");
  Object.assign(player, { selected, partner: partner === selected ? null : partner });
  player.open(Math.max(index, 0), index < 0 ? 0 : Math.trunc(Number(state.get("cycle"))) || 0);
}

let noticeTimer = 0;

function notify(message) {
  byId("notice").textContent = message;
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => (byId("notice").textContent = ""), 4000);
}

async function copyLink() {
  updateAddress();
  try {
    await navigator.clipboard.writeText(location.href);
    notify("Link copied.");
  } catch {
    notify("The link is in the address bar.");
  }
}

function fillScenarios() {
  replay.runs[0].scenarios.forEach(({ number }, index) => {
    const flown = replay.runs.map((run) => run.scenarios[index]);
    const counts = flown.map((each) => transmissionsOf(each.clearances).length).join(" and ");
    const lost = flown.some((each) => each.losses.length) ? ", loss of separation" : "";
    const reasons = new Set(flown.flatMap((each) => each.failures.map(({ reason }) => reason)));
    const why = [...reasons].map((each) => REASONS.get(each) ?? each).join(", ");
    const isFailed = flown.some((each) => each.success === false);
    const failed = isFailed ? `, failed${why && `: ${why}`}` : "";
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
  const part = player.speed <= SMOOTH_UP_TO && !reducedMotion.matches ? player.elapsed : 0;
  const { index, row, selected, partner } = player;
  const canvases = panes.flatMap(({ scope, profile }) => [scope.canvas, profile.canvas]);
  const sizes = canvases.map((canvas) => [canvas.clientWidth, canvas.clientHeight]);
  const seen = [view.zoom, view.centre, sizes, look.theme, devicePixelRatio];
  const overlays = panes.map(({ scope }) => scope.overlay?.version);
  const chosen = [selected, partner, display, measure.ends, overlays];
  const wanted = JSON.stringify([index, row, part, chosen, seen]);
  if (wanted !== drawn) panes.forEach((pane, lane) => drawPane(pane, player.runs[lane], part));
  drawn = wanted;
  requestAnimationFrame(frame);
}

function drawPane({ scope, panels, profile }, run, part) {
  scope.draw(part, player, display, measure);
  profile.draw(run, player.row);
  const shown = scope.flying.filter((each) => scope.isShown(each, player, display));
  panels.note(scope.line, display, scope.flying.length, shown.length);
}

/** Starts or ends measuring. With two aircraft selected, the line joins them. */
function toggleMeasuring() {
  display.measuring = !display.measuring;
  measure.clear();
  if (display.measuring && player.partner !== null) {
    measure.from({ callsign: player.selected });
    measure.to({ callsign: player.partner });
  }
  document.body.classList.toggle("measuring", display.measuring);
  options.show();
}

function clear() {
  if (options.close()) return;
  if (display.measuring || measure.ends) {
    display.measuring = true;
    toggleMeasuring();
  } else {
    player.select(null);
  }
}

/** The name of a downloaded file: only the scenario and the time, no recorded text. */
function fileName(kind) {
  const time = minutes(player.row * replay.cycle_s).replace(":", "m");
  return `replay-scenario-${player.packed.number}${kind === "png" ? `-${time}s` : ""}.${kind}`;
}

function downloadPicture() {
  const time = minutes(player.row * replay.cycle_s);
  const about = `scenario ${player.packed.number}, ${time}`;
  const headings = replay.runs.map(({ title }) => `${title}, ${about}`);
  const canvases = panes.map(({ scope }) => scope.canvas);
  pictureOf(canvases, headings).toBlob((blob) => download(fileName("png"), blob), "image/png");
}

function downloadClearances() {
  const titles = replay.runs.map(({ title }) => title);
  const text = csvOf(titles, player.packed.number, player.runs, replay.cycle_s);
  download(fileName("csv"), new Blob([text], { type: "text/csv;charset=utf-8" }));
}

/** Changes the display, and shows the change. */
const change = (action) => () => {
  action();
  options.show();
  refresh();
};

const keys = keysOf(player, view, {
  canvas: panes[0].scope.canvas,
  find: () => options.find.select(),
  clear,
  measure: toggleMeasuring,
  profile: change(() => (display.profile = !display.profile)),
  rings: change(() => (display.rings = !display.rings)),
  vector: change(() => display.nextVector()),
  trail: change(() => display.nextTrail()),
  options: () => options.toggle(),
  picture: downloadPicture,
  csv: downloadClearances,
  theme: () => (look.theme = look.theme === "light" ? "dark" : "light"),
  link: copyLink,
  help: () => byId("help").showModal(),
});
const usedKeys = replay.live ? keys.filter(({ many }) => !many) : keys;
listenToKeys(usedKeys);
wireButtons(keys);
fillHelp(byId("keys"), usedKeys);
fillScenarios();
byId("panes").classList.toggle("two", panes.length > 1);
byId("scenario").addEventListener("change", (event) => player.open(Number(event.target.value)));
byId("speed").addEventListener("change", (event) => player.faster(
  SPEEDS.indexOf(Number(event.target.value)) - SPEEDS.indexOf(player.speed),
));
const followSystemTheme = () => (look.theme = prefersLight.matches ? "light" : "dark");
prefersLight.addEventListener("change", followSystemTheme);
followSystemTheme();
// The page may have changed its address again before the event arrives.
addEventListener("hashchange", ({ newURL }) => openAddress(newURL));
openAddress(location.href);
player.faster(0);
requestAnimationFrame(frame);
