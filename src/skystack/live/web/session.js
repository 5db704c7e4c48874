// Connects the page to the session, and its console to the page.

const RETRY_MS = 1000;
const REFRESH_MS = 1500;

class Connection {
  /** `onNews` is called with what is new. */
  constructor(onNews) {
    Object.assign(this, { onNews, socket: null, number: 0, waiting: new Map() });
    this.has = { epoch: -1, updates: 0 };
    this.open();
  }

  open() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    this.socket = socket;
    socket.addEventListener("open", () => {
      document.body.classList.remove("lost");
      notify("");
      socket.send(JSON.stringify({ do: "follow", ...this.has }));
    });
    socket.addEventListener("message", ({ data }) => this.receive(JSON.parse(data)));
    socket.addEventListener("close", () => {
      document.body.classList.add("lost");
      notify("No connection to the session. Reconnecting …");
      for (const answer of this.waiting.values()) answer({ kind: "refused", reason: "no connection" });
      this.waiting.clear();
      setTimeout(() => this.open(), RETRY_MS);
    });
  }

  receive(message) {
    if (message.kind === "news") {
      this.has = { epoch: message.epoch, updates: message.begin + message.updates.length };
      this.onNews(message);
      return;
    }
    const answer = this.waiting.get(message.id);
    this.waiting.delete(message.id);
    if (answer) answer(message);
    else if (message.kind === "refused") notify(message.reason);
  }

  /** Sends a message; returns a promise of the reply. */
  ask(message) {
    const id = ++this.number;
    if (this.socket.readyState !== WebSocket.OPEN) {
      return Promise.resolve({ kind: "refused", reason: "no connection" });
    }
    this.socket.send(JSON.stringify({ ...message, id }));
    return new Promise((answer) => this.waiting.set(id, answer));
  }

  /** Sends a message whose reply matters only if it is refused. */
  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}

const [pane] = panes;
let epoch = -1;
let conditions = { handed: [], hands_all: false, not_on_frequency: [], waiting: 0 };
const connection = new Connection(showNews);
const ask = (message) => connection.ask(message);
const draft = new Draft(player, pane.scope, ask);
const advice = new Advice(ask, draft);
const monitor = new Monitor(pane.scope, replay.cycle_s, (pair) => goToPair(pane.scope, pair, undefined));
display.rings = false; // there will be many aircraft
options.show();
player.send = (message) => connection.send(message);

function showNews(news) {
  const [run] = player.runs;
  if (news.epoch !== epoch || news.begin === 0) {
    emptyRun(run);
    player.clearanceRows = [];
    player.callsigns = [];
    pane.panels.open(run);
    pane.alerts.open(run);
  }
  epoch = news.epoch;
  const before = [run.aircraft.length, run.transmissions.length, run.losses.length];
  for (const update of news.updates) grow(run, update);
  conditions = news.status;
  player.follow(run.cycles, news.status);
  if (String(before) !== String([run.aircraft.length, run.transmissions.length, run.losses.length])) {
    player.callsigns = callsignsOf(run);
    player.clearanceRows = [...new Set(run.clearances.map(({ row }) => row))];
    options.open();
    timeline.open();
    pane.alerts.open(run);
  }
  pane.panels.grow();
  monitor.show(news.monitor);
  refresh();
  showControl();
  advice.show(news.advice, news.status.cycle);
  advice.offer(news.monitor, news.status);
  if (news.problem) notify(news.problem);
}

/** Who controls what, and where the session is. */
function showControl() {
  const { hands_all: handsAll, handed, adviser, playing, cycle, cycles, waiting } = conditions;
  const unflown = player.runs[0].clearances.filter(({ row }) => row > cycle);
  const pending = new Set(unflown.map(({ callsign }) => callsign));
  const selected = draft.aircraft?.callsign;
  const isHanded = handsAll || handed.includes(selected);
  const [one, all] = ["hand-one", "hand-all"].map((name) => document.querySelector(`[data-do="${name}"]`));
  for (const button of [one, all]) button.hidden = !adviser;
  one.disabled = !selected;
  one.textContent = selected ? `${isHanded ? "Take back" : "Hand over"} ${selected}` : "Hand over a flight";
  all.textContent = handsAll || handed.length ? "Take back all" : `Hand all to ${adviser}`;
  const who = handsAll
    ? `${adviser} controls all flights.`
    : handed.length
      ? `${adviser} controls ${handed.join(", ")}; you control the others.`
      : "You control all flights.";
  const state = cycle >= cycles ? " The session has ended." : playing ? "" : " Paused.";
  const held = waiting ? ` ${counted(waiting, "flight")} waiting to enter.` : "";
  setText(byId("who"), who + held + state);
  document.querySelector('[data-do="rewind"]').hidden = player.isFollowing;
  for (const { item, aircraft } of pane.panels.rows) {
    const { callsign } = aircraft;
    item.classList.toggle("gone", aircraft.rows <= player.row);
    item.classList.toggle("handed", handsAll || handed.includes(callsign));
    item.classList.toggle("not-on-frequency", conditions.not_on_frequency.includes(callsign));
    item.classList.toggle("pending", pending.has(callsign));
  }
}

const actions = {
  "hand-one": () => {
    const callsign = draft.aircraft?.callsign;
    if (!callsign) return;
    const isHanded = conditions.hands_all || conditions.handed.includes(callsign);
    connection.send({ do: "hand_over", callsigns: [callsign], to_adviser: !isHanded });
  },
  "hand-all": () => {
    const isHanded = conditions.hands_all || conditions.handed.length > 0;
    connection.send({ do: "hand_over", callsigns: [], to_adviser: !isHanded });
  },
  advise: () => advice.request(),
  rewind: async () => {
    if (player.isFollowing) return;
    notify("Saving the later history …");
    const reply = await ask({ do: "rewind", cycle: player.row });
    notify(reply.reason ?? "");
    if (reply.kind !== "refused") player.isFollowing = true;
  },
  sound: () => {
    monitor.sound = monitor.sound ? null : new AudioContext();
    document.querySelector('[data-do="sound"]').setAttribute("aria-pressed", String(monitor.sound !== null));
  },
};

/** Adds a button to a group of the page. */
function addButton(parent, name, text, title) {
  const button = element("button", "", text);
  Object.assign(button.dataset, { do: name });
  button.title = title;
  parent.append(button);
}

addButton(document.querySelector(".transport"), "rewind", "Continue from here", "go back to this cycle; the later history is saved (B)");
addButton(document.querySelector(".tools"), "sound", "Sound", "a tone when a loss of separation is near (U)");
for (const button of document.querySelectorAll("[data-do]")) {
  button.addEventListener("click", () => actions[button.dataset.do]());
}

const liveKeys = [
  { keys: ["Enter", "e"], shown: "Enter or E", does: "type a clearance", run: () => draft.input.focus() },
  { keys: ["q"], shown: "Q", does: "ask for advice", run: actions.advise },
  { keys: ["j"], shown: "J", does: "hand the selected flight over, or take it back", run: actions["hand-one"] },
  { keys: ["x"], shown: "X", does: "hand all flights over, or take them back", run: actions["hand-all"] },
  { keys: ["b"], shown: "B", does: "continue from the cycle shown", run: actions.rewind },
  { keys: ["u"], shown: "U", does: "sound on or off", run: actions.sound },
];
listenToKeys(liveKeys);
fillHelp(byId("keys"), [
  ...liveKeys,
  { shown: "Alt+1 to 3", does: "accept an alternative" },
  { shown: "drag", does: "from the selected aircraft: a heading" },
]);
document.addEventListener("keydown", (event) => {
  if (!event.altKey || !/^Digit[123]$/.test(event.code)) return;
  event.preventDefault();
  const item = advice.list.children[Number(event.code.at(-1)) - 1];
  item?.querySelector("button")?.click();
});

let chosen = null;

player.onChange = (what) => {
  if (what === "selection" && player.selected !== chosen) {
    chosen = player.selected;
    draft.select();
  }
  showControl();
};
setInterval(() => draft.refresh(), REFRESH_MS);
