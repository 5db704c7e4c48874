// The advice: the most urgent situation and its alternatives, which are accepted, modified or refused.

const OFFERED_S = 300; // a loss this soon is a reason to offer advice
const OFFERED_CYCLES = 5; // the same pair is not offered again for this many cycles
const OFFERED_SPEED = 10; // at higher speeds, advice would be out of date at once

class Advice {
  constructor(ask, draft) {
    Object.assign(this, { ask, draft, news: null, shown: null, given: null, offered: null });
    [this.situation, this.list] = [byId("situation"), byId("alternatives")];
    byId("offer").addEventListener("change", () => this.news && this.offer(...this.news));
  }

  async request() {
    setText(this.situation, "…");
    const reply = await this.ask({ do: "advise", conforms: byId("conforms").checked });
    if (reply.kind === "refused") setText(this.situation, reply.reason);
    else if (!reply.advised) setText(this.situation, "Nothing needs a clearance.");
  }

  /** Asks for advice when a loss is predicted, unless advice for this pair is valid or was offered
   *  in the last cycles. */
  offer(monitor, status) {
    this.news = [monitor, status];
    const { cycle, pairs } = monitor;
    const { playing, speed, hands_all: handsAll } = status;
    const isWanted = byId("offer").checked && !handsAll && !(playing && speed > OFFERED_SPEED);
    const lost = pairs.filter(({ lost_in_s: lostInS }) => lostInS !== null && lostInS <= OFFERED_S);
    if (!isWanted || !lost.length) return;
    lost.sort((one, other) => one.lost_in_s - other.lost_in_s);
    const pair = pairOf(lost[0].callsigns);
    if (this.offered && cycle < this.offered.cycle) this.offered = null; // the session went back
    const isGiven = this.given && this.given.pair === pair && cycle <= this.given.until;
    const isRecent = this.offered && this.offered.pair === pair && cycle <= this.offered.cycle + OFFERED_CYCLES;
    if (isGiven || isRecent) return;
    this.offered = { pair, cycle };
    this.request();
  }

  /** Shows advice from the server, which is marked when it is out of date. */
  show(advice, cycle) {
    const isOld = advice !== null && cycle > advice.until_cycle;
    this.given = advice && { pair: pairOf(advice.callsigns), until: advice.until_cycle };
    const key = JSON.stringify([advice, isOld]);
    if (key === this.shown) return;
    const isFirst = this.shown === null;
    this.shown = key;
    this.list.classList.toggle("old", isOld);
    if (advice === null) {
      if (!isFirst) setText(this.situation, "");
      this.list.replaceChildren();
      return;
    }
    this.number = advice.number;
    setText(this.situation, situationWords(advice) + (isOld ? " (time has passed: ask again)" : ""));
    this.list.replaceChildren(...advice.alternatives.map((each, rank) => this.item(each, rank, isOld)));
  }

  item(alternative, rank, isOld) {
    const item = element("li");
    item.append(element("p", "words", alternative.words));
    for (const { after_s: afterS, words } of alternative.later) {
      item.append(element("p", "later", `then, ${minutes(afterS)} later: ${words}`));
    }
    item.append(element("p", "effects", effectsOf(alternative)));
    const group = element("div", "group");
    const buttons = [
      ["Accept", () => this.answer(rank, "accept")],
      ["Modify", () => this.modify(alternative, rank)],
      ["Refuse", () => this.answer(rank, "refuse", item)],
    ];
    for (const [name, run] of buttons) {
      const button = element("button", "", name);
      button.disabled = isOld && name !== "Modify";
      if (name === "Accept") button.title = `Alt+${rank + 1}`;
      button.addEventListener("click", run);
      group.append(button);
    }
    item.append(group);
    for (const name of ["pointerenter", "focusin"]) {
      item.addEventListener(name, () => this.draft.preview(alternative));
    }
    item.addEventListener("pointerleave", () => this.draft.preview(null));
    return item;
  }

  async answer(rank, answer, item = null) {
    const reply = await this.ask({ do: "answer", number: this.number, rank, answer });
    if (reply.kind === "refused") this.draft.showAnswer(reply.reason, true);
    else if (answer === "accept") this.draft.showAnswer(`“${reply.read_back}”`);
    else item?.classList.add("refused");
    this.draft.preview(null);
  }

  /** Puts an alternative into the clearance field, to be changed. */
  modify(alternative, rank) {
    this.draft.player.select(alternative.callsign);
    this.draft.modifies = { of: [this.number, rank], callsign: alternative.callsign };
    this.draft.input.value = alternative.words;
    this.draft.changed();
    this.draft.input.focus();
  }
}

/** The same text for both orders of two callsigns. */
function pairOf(callsigns) {
  return [...callsigns].sort().join(" ");
}

function situationWords({ kind, callsigns, lost_in_s: lostInS, least_nm: leastNm }) {
  const who = callsigns.join(" and ");
  if (kind === "exit") return `${who}: no correct exit as cleared.`;
  return `${who}: if nothing is issued, separation is lost in ${minutes(lostInS)}, least ${nmText(leastNm)}.`;
}

function effectsOf(alternative) {
  const { extra_nm: extraNm, level_change_fl: levels, source, instructions } = alternative;
  const signed = (value, digits) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;
  const miles = extraNm === null ? "" : `${signed(extraNm, 1)} NM; `;
  const climb = levels ? `${signed(levels, 0)} FL; ` : "";
  const stacked = instructions > 1 ? `, ${instructions} instructions stacked` : "";
  return `${miles}${climb}${trialWords(alternative)} (${source}${stacked}${certaintyOf(alternative)})`;
}

/** How certain the adviser is, and whether the best trial plan begins in the same way. */
function certaintyOf({ probability, entropy, agrees }) {
  const certain = probability === null
    ? ""
    : `, instructs with probability ${probability.toFixed(2)}, entropy ${entropy.toFixed(2)}`;
  return certain + (agrees === null ? "" : agrees ? ", best trial plan agrees" : ", best trial plan differs");
}
