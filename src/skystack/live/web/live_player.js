// The state of a live session: the newest row is followed until the viewer looks back.

class LivePlayer extends Player {
  constructor(replay, changed) {
    super(replay, (what) => {
      changed(what);
      this.onChange(what);
    });
    this.onChange = () => {}; // until the console is there
    this.status = { cycle: 0, cycles: 0, playing: false, speed: 1 };
    this.isFollowing = true;
    this.speed = 1;
    this.wantedSpeed = null; // until the server confirms it
    this.send = () => {}; // until there is a connection
  }

  get words() {
    return {
      toggle: "run or pause the session; in the past, play or pause",
      forward: "pause the session and fly one cycle; in the past, one cycle forward",
      end: "return to the present",
    };
  }

  get length() {
    return Math.max(this.status.cycles, this.lastRow, 1);
  }

  get isMoving() {
    return this.playing || (this.isFollowing && this.status.playing);
  }

  /** Opens the session once; later calls, such as after a change of the address, only go to a row. */
  open(index, row = 0) {
    if (this.runs.length) this.goTo(row);
    else super.open(index);
  }

  /** Runs or pauses the session, or what is shown of the past. */
  toggle() {
    if (this.isFollowing) this.send({ do: "play", on: !this.status.playing });
    else this.play(!this.playing);
  }

  goTo(row) {
    super.goTo(row);
    this.isFollowing = this.row === this.lastRow;
    if (this.isFollowing) this.playing = false;
    this.changed("playing");
  }

  /** One cycle on: of the past if it is shown, else of the session. */
  step(rows) {
    if (this.isFollowing && rows === 1) this.send({ do: "step" });
    else super.step(rows);
  }

  faster(steps) {
    super.faster(steps);
    if (!steps || !this.isFollowing) return;
    this.wantedSpeed = this.speed;
    this.send({ do: "speed", times: this.speed });
  }

  /** Takes over the newest row, and what the server says of the session. */
  follow(lastRow, status) {
    this.lastRow = lastRow;
    this.status = status;
    if (status.speed === this.wantedSpeed) this.wantedSpeed = null;
    if (this.isFollowing && this.wantedSpeed === null) this.speed = status.speed;
    this.goTo(this.isFollowing ? lastRow : this.row);
  }
}
