// The clearance that is being prepared: its text, what it would lead to, and the choices by mouse.

const TRY_AFTER_MS = 120; // after the last change of the text
const DRAG_PX = 8;

class Draft {
  /** `ask(message)` sends a message and returns a promise of the reply. */
  constructor(player, scope, ask) {
    Object.assign(this, { player, scope, ask, timer: 0, version: 0, modifies: null, words: {} });
    Object.assign(this, { trial: null, previewed: null }); // of the text; of an alternative pointed at
    [this.input, this.answer, this.about] = [byId("clearance"), byId("answer"), byId("trial")];
    [this.choices, this.ladder, this.fixes] = [byId("choices"), byId("ladder"), byId("fixes")];
    this.input.addEventListener("input", () => this.changed());
    this.input.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      this.clear();
      this.input.blur();
    });
    byId("issue").addEventListener("submit", (event) => {
      event.preventDefault();
      this.issue();
    });
    for (const button of document.querySelectorAll("[data-turn]")) {
      button.addEventListener("click", () => this.turnBy(Number(button.dataset.turn)));
    }
    this.listenToDrag(scope.canvas);
    scope.overlay = this;
  }

  /** The selected flight, if it is on the radar now. */
  get aircraft() {
    const { runs, selected, lastRow } = this.player;
    const found = runs[0].aircraft.find((each) => each.callsign === selected);
    return found && isFlying(found, lastRow) ? found : null;
  }

  get last() {
    return this.player.lastRow;
  }

  /** Shows the choices for the selected flight. */
  select() {
    const { aircraft } = this;
    [this.words, this.headingDeg] = [{}, null];
    this.choices.hidden = !aircraft;
    this.clear(aircraft ? `${aircraft.callsign} ` : "");
    this.ladder.replaceChildren();
    this.fixes.replaceChildren();
    this.choicesOf = null; // the situation for which the levels and fixes are shown
    this.askChoices();
  }

  /** The situation, to see whether it has changed. */
  get situation() {
    const [run] = this.player.runs;
    return JSON.stringify([this.aircraft?.callsign, run.cycles, run.clearances.length]);
  }

  /** Tries again and asks again what is out of date. */
  refresh() {
    if (this.trial && this.triedIn !== this.situation) this.tryNow(this.input.value.trim());
    this.askChoices();
  }

  /** Sets a part of the clearance, `way` or `level`, and tries the whole. */
  set(part) {
    const { aircraft } = this;
    if (!aircraft) return;
    Object.assign(this.words, part);
    const { way, level } = this.words;
    this.input.value = `${aircraft.callsign} ${[way, level].filter(Boolean).join(", ")}`;
    this.changed();
  }

  turnBy(degrees) {
    const { aircraft } = this;
    if (aircraft) this.turnTo((this.headingDeg ?? aircraft.headingDeg[this.last]) + degrees);
  }

  turnTo(degrees) {
    const now = this.aircraft.headingDeg[this.last];
    const change = ((((degrees - now) % 360) + 540) % 360) - 180;
    const heading = threeDigits(degrees);
    this.headingDeg = degrees;
    const side = threeDigits(now) === heading ? "fly" : change < 0 ? "turn left" : "turn right";
    this.set({ way: `${side} heading ${heading}` });
  }

  levelTo(fl) {
    const now = this.aircraft.fl[this.last];
    const verb = Math.abs(fl - now) < 0.5 ? "maintain" : fl > now ? "climb" : "descend";
    this.set({ level: `${verb} FL${fl}` });
  }

  changed() {
    clearTimeout(this.timer);
    this.show(null);
    this.showAnswer("");
    const text = this.input.value.trim();
    if (text.split(/\s+/).length < 2) return;
    this.timer = setTimeout(() => this.tryNow(text), TRY_AFTER_MS);
  }

  async tryNow(text) {
    this.triedIn = this.situation;
    const reply = await this.ask({ do: "trial", text });
    if (this.input.value.trim() !== text) return; // it has been changed in the meantime
    this.show(reply.trial ?? null);
    this.showAnswer(reply.reason ?? "", reply.kind === "refused");
  }

  async issue() {
    const text = this.input.value.trim();
    if (!text) return;
    clearTimeout(this.timer);
    const begins = `${this.modifies?.callsign} `.toUpperCase();
    const isModified = this.modifies !== null && text.toUpperCase().startsWith(begins);
    const modifies = isModified ? { modifies: this.modifies.of } : {};
    const reply = await this.ask({ do: "clear", text, ...modifies });
    if (reply.kind === "refused") {
      this.showAnswer(reply.reason, true);
      return;
    }
    [this.words, this.headingDeg] = [{}, null];
    this.clear(this.aircraft ? `${this.aircraft.callsign} ` : "");
    this.showAnswer(`“${reply.read_back}”`);
  }

  clear(text = "") {
    clearTimeout(this.timer);
    this.input.value = text;
    this.modifies = null; // the advice and the alternative that the text changes
    this.show(null);
    this.showAnswer("");
  }

  showAnswer(words, isRefusal = false) {
    setText(this.answer, words);
    this.answer.classList.toggle("loss", isRefusal);
  }

  show(trial) {
    this.trial = trial;
    this.preview(null);
  }

  /** Shows the trial of an alternative instead; with null, that of the clearance again. */
  preview(trial) {
    this.previewed = trial;
    this.version += 1;
    const shown = trial ?? this.trial;
    setText(this.about, shown ? `${shown.words}: ${trialWords(shown)}` : "");
    this.about.classList.toggle("loss", Boolean(shown) && shown.lost_in_s !== null);
  }

  /** Asks for the levels and fixes to which the selected flight may be cleared. */
  async askChoices() {
    const { aircraft, situation } = this;
    if (!aircraft || situation === this.choicesOf) return;
    this.choicesOf = situation;
    const reply = await this.ask({ do: "choices", callsign: aircraft.callsign });
    if (this.aircraft !== aircraft || !reply.levels) return;
    this.fixes.replaceChildren(
      ...reply.fixes.map((fix) => {
        const button = element("button", "", fix);
        button.addEventListener("click", () => {
          this.headingDeg = null;
          this.set({ way: `direct ${fix}` });
        });
        return button;
      }),
    );
    const cleared = aircraft.clearedFl[this.last];
    this.ladder.replaceChildren(
      ...reply.levels.map(({ fl, lost_in_s: lostInS, least_nm: leastNm }) => {
        const button = element("button", lostInS === null ? "free" : "taken", String(fl));
        const near = leastNm === null ? "" : `, closest ${nmText(leastNm)}`;
        button.title = lostInS === null ? `free${near}` : `separation lost in ${minutes(lostInS)}`;
        button.setAttribute("aria-label", `FL${fl}, ${button.title}`);
        if (fl === aircraft.exitFl) button.classList.add("exit");
        if (fl === cleared) button.setAttribute("aria-current", "true");
        button.addEventListener("click", () => this.levelTo(fl));
        return button;
      }),
    );
  }

  /** A drag from the selected flight sets its heading. */
  listenToDrag(canvas) {
    const placeOf = ({ offsetX, offsetY }) => [offsetX, offsetY];
    let begun = null;
    const listen = (name, listener) => canvas.parentElement.addEventListener(name, listener, true);
    listen("pointerdown", (event) => {
      const { aircraft } = this;
      const isOn = aircraft && this.scope.hit(...placeOf(event)) === aircraft.callsign;
      const isPlain = event.isPrimary && !event.shiftKey && this.player.isFollowing;
      begun = isOn && isPlain ? placeOf(event) : null;
      if (!begun) return;
      canvas.setPointerCapture(event.pointerId);
      event.stopPropagation(); // the radar would be moved
    });
    listen("pointermove", (event) => {
      if (!begun || !this.aircraft) return;
      event.stopPropagation();
      const [x, y] = placeOf(event);
      if (Math.hypot(x - begun[0], y - begun[1]) < DRAG_PX) return;
      const { clientWidth: width, clientHeight: height } = canvas;
      const to = this.scope.view.toPlane(width, height)(x, y);
      const from = positionOf(this.aircraft, this.last, 0);
      this.turnTo((Math.atan2(to[0] - from[0], to[1] - from[1]) * 180) / Math.PI);
    });
    listen("pointerup", (event) => {
      if (!begun) return;
      const [x, y] = placeOf(event);
      const isDrag = Math.hypot(x - begun[0], y - begun[1]) >= DRAG_PX;
      begun = null;
      if (isDrag) event.stopPropagation();
      else this.player.pick(this.aircraft?.callsign ?? null, event.shiftKey);
    });
  }

  /** Draws the trial on the radar: the path, and the flight's position at the closest approach. */
  draw(pen) {
    const trial = this.previewed ?? this.trial;
    if (!trial || !this.player.isFollowing) return; // it is of the present
    const { path, lost_in_s: lostInS, approaches } = trial;
    const colour = pen.colour[lostInS === null ? "selected" : "loss"];
    const points = path.map((at) => pen.at(...at));
    stroke(pen, points, colour, { width: 2, dash: [2, 4] });
    const [nearest] = approaches;
    if (!nearest) return;
    const row = Math.min(Math.round(nearest.in_s / trial.path_s), points.length - 1);
    const at = points[row];
    ring(pen, at, this.scope.ringNm * pen.nm(path[row][1]), colour, { dash: [4, 4] });
    write(pen, `${nearest.callsign} ${nmText(nearest.least_nm)}`, at[0] + 8, at[1] - 10, colour);
  }
}

/** What a trial leads to, in words. */
function trialWords({ approaches, lost_in_s: lostInS, leaves_correctly: isCorrect }) {
  const [nearest] = approaches;
  const near = nearest
    ? `closest ${nearest.callsign}, ${nmText(nearest.least_nm)} in ${minutes(nearest.in_s)}`
    : "nobody within 15 NM";
  const lost = lostInS === null ? "" : `separation lost in ${minutes(lostInS)}; `;
  return `${lost}${near}; ${isCorrect ? "correct exit" : "exit needs another clearance"}`;
}
