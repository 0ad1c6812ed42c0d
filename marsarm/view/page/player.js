// Player of a run: clock, time line, event reports, keys and controls around scene and plots.
"use strict";

const SLOWEST_S = 1 / 24; // longer frames than those of a film do not look smooth
const COARSENESS = [1, 1.4, 2]; // in pixels of the screen: a link, 0.1 m, is still 9 pixels wide in the first view
const PATIENCE_S = 0.6; // between two changes of the coarseness, and before a picture that rests is drawn finely
const CONTACT_S = 20; // before and after a contact the camera is near the tool
const STEP_S = 5;
const SEVERITY_CLASS = (severity) => (severity >= 5 ? "bad" : severity >= 4 ? "warn" : "");
const SWITCHES = { ghost: "g", trail: "t" };
const tell = (id, text) => tellIn(byId(id), text);

/** Unpack the arrays of the page: one gzip stream, in which `run.arrays` gives type, start and length of each. */
async function unpack(run) {
  const packed = Uint8Array.from(atob(byId("data").textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = await new Response(stream).arrayBuffer();
  const types = { f4: Float32Array, u4: Uint32Array };
  return Object.fromEntries(run.arrays.map(([name, type, at, length]) => [name, new types[type](bytes, at, length)]));
}

function fillEvents(player) {
  player.rows = player.run.events.map(([time, severity, text], k) => {
    const item = element("li"), button = element("button", { type: "button", className: SEVERITY_CLASS(severity) });
    button.append(element("time", { textContent: time.toFixed(1) + " s" }), text);
    button.addEventListener("click", () => player.seek(time));
    button.addEventListener("dblclick", () => player.show(time, player.nextEvent(k)));
    item.append(button);
    byId("events").append(item);
    return [time, button];
  });
}

function drawMarks(player) {
  const [context, width, height] = sheet(byId("marks"));
  const colour = { "": style("--faint"), warn: style("--warn"), bad: style("--bad") };
  // the thumb of the slider is 16 px wide, and its centre stands at the time
  const x = (time) => 8 + ((time - player.start) / player.span) * (width - 16);
  context.fillStyle = style("--range");
  context.fillRect(x(player.range[0]), 0, x(player.range[1]) - x(player.range[0]), height);
  for (const [time, severity] of player.run.events) {
    context.fillStyle = colour[SEVERITY_CLASS(severity)];
    context.fillRect(x(time) - 1, severity >= 4 ? 0 : 4, 2, height);
  }
}

class Player {
  constructor(run, arrays) {
    Object.assign(this, { run, motion: new Motion(run, arrays), playing: false, drawn: 0, isStale: true });
    const { time, count } = this.motion;
    [this.start, this.end, this.time] = [time[0], time[count - 1], time[0]];
    this.span = Math.max(this.end - this.start, 1e-3);
    this.range = [this.start, this.start + this.span];
    this.truth = arrays.true ? "true" : "believed";
    this.painter = new Painter(byId("scene"), run, arrays);
    this.orbit = new Orbit(byId("scene"), run.target);
    this.plots = run.plots.map((plot) => new Plot(plot, arrays, this));
    this.toolError = arrays["tool error"];
    this.contacts = Array.from(time).filter((_, k) => this.motion.sizeOfForce([k, 0]) > run.looks.arrow.least_N);
    Object.assign(this, { level: 0, calm: 0, pace: SLOWEST_S / 2 });
    this.wire();
    fillEvents(this);
    this.layOut();
    this.readLink();
    window.addEventListener("hashchange", () => this.readLink());
    if (!location.hash && !matchMedia("(prefers-reduced-motion: reduce)").matches) this.toggle();
  }

  wire() {
    const again = () => { this.isStale = true; };
    const { speeds, first_speed: first, magnification } = this.run.looks;
    for (const speed of speeds) byId("speed").append(new Option(speed + "×", speed, false, speed === first));
    byId("play").addEventListener("click", () => this.toggle());
    byId("slider").addEventListener("input", () => this.seek(this.start + byId("slider").value * this.span));
    byId("magnify").max = Math.log(magnification);
    for (const id of ["magnify", ...Object.keys(SWITCHES)]) byId(id).addEventListener("input", again);
    byId("camera").addEventListener("input", () => { this.orbit.isFree = false; again(); });
    for (const name of ["pointermove", "wheel"]) byId("scene").addEventListener(name, again);
    if (this.truth === "believed") byId("ghost").closest("label").hidden = true;
    byId("link").addEventListener("click", () => this.copyLink());
    byId("all").addEventListener("click", () => this.show());
    window.addEventListener("resize", () => this.layOut());
    DARK.addEventListener("change", () => this.layOut());
    document.addEventListener("keydown", (e) => this.press(e));
  }

  press(e) {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.matches("select, input[type=range]")) return;
    if (e.key === " " && e.target.matches("button, input")) return; // it presses that one
    const event = this.rows.filter(([time]) => time > this.time + 1e-3)[0], before = this.rows.filter(([time]) => time < this.time - 0.5).pop();
    const actions = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.seek(this.time - STEP_S), ArrowRight: () => this.seek(this.time + STEP_S),
      Home: () => this.seek(this.start), End: () => this.seek(this.end),
      n: () => event && this.seek(event[0]), p: () => before && this.seek(before[0]),
      "+": () => this.zoom(0.5), "-": () => this.zoom(2), 0: () => this.show(),
      f: () => { byId("camera").value = byId("camera").value === "tool" ? "all" : "tool"; this.orbit.isFree = false; },
      d: () => { byId("magnify").value = this.factor > 1 ? 0 : Math.log(20); },
    };
    for (const [id, key] of Object.entries(SWITCHES)) actions[key] = () => byId(id).click();
    if (!actions[e.key]) return;
    e.preventDefault();
    actions[e.key]();
    this.isStale = true;
  }

  layOut() {
    this.plots.forEach((plot) => plot.layOut());
    drawMarks(this);
    byId("all").hidden = this.range[0] === this.start && this.range[1] >= this.end;
    this.isStale = true;
  }

  get speed() { return Number(byId("speed").value); }
  get factor() { return Math.exp(byId("magnify").value); }

  toggle() {
    if (!this.playing && this.time >= this.end) this.seek(this.start);
    this.playing = !this.playing;
    tell("play", this.playing ? "Pause" : "Play");
  }

  seek(time) {
    this.time = Math.min(Math.max(time, this.start), this.end);
    this.isStale = true;
  }

  /** Show the values at a time under the pointer; those at the time of the scene if it is null. */
  point(time) {
    this.pointed = time;
    this.isStale = true;
  }

  /** Show a range of time in the plots; all of it without one. */
  show(start = this.start, end = this.start + this.span) {
    const half = Math.max(end - start, 4 * this.span / this.motion.count) / 2, middle = (start + end) / 2;
    this.range = [Math.max(middle - half, this.start), Math.min(middle + half, this.start + this.span)];
    this.layOut();
  }

  zoom(factor) {
    const [start, end] = this.range;
    this.show(this.time + factor * (start - this.time), this.time + factor * (end - this.time));
  }

  nextEvent(k) {
    return (this.run.events.find(([time]) => time > this.run.events[k][0]) ?? [this.end])[0];
  }

  /** Return the rows of a range of time, with one before and one after. */
  rowsBetween(start, end) { return [this.motion.at(start)[0], Math.min(this.motion.at(end)[0] + 1, this.motion.count - 1)]; }

  /** Move to the moment and the view that the address names. */
  readLink() {
    const given = new URLSearchParams(location.hash.slice(1)), number = (name) => Number(given.get(name));
    if (!given.has("t") || !Number.isFinite(number("t"))) return;
    if (this.playing) this.toggle();
    this.seek(number("t"));
    if (number("x") >= 1) byId("magnify").value = Math.log(number("x"));
    if (byId("camera").querySelector(`[value="${CSS.escape(given.get("camera") ?? "")}"]`)) byId("camera").value = given.get("camera");
    this.approach(Infinity);
  }

  /** Write the moment and the view into the address, and copy it. */
  async copyLink() {
    if (this.playing) this.toggle();
    const link = `#t=${this.time.toFixed(2)}&x=${this.factor.toFixed(1)}&camera=${byId("camera").value}`;
    history.replaceState(null, "", link);
    try {
      await navigator.clipboard.writeText(location.href);
      tell("link", "Link copied");
    } catch {
      tell("link", "Link is in the address bar");
    }
    setTimeout(() => tell("link", "Link to this moment"), 2000);
  }

  /** Advance by wall time in seconds at the chosen speed. */
  advance(wall) {
    if (!this.playing) return;
    this.seek(this.time + wall * this.speed);
    if (this.time >= this.end) this.toggle();
  }

  /** Move the camera for a wall time; by itself it is near the tool around each contact. */
  approach(wall) {
    const wanted = byId("camera").value, ahead = CONTACT_S;
    const isNear = wanted === "tool" || (wanted === "auto" && this.contacts.some((time) => Math.abs(time - this.time) < ahead));
    const tool = isNear ? this.motion.tool(this.truth, this.motion.at(this.time), this.factor) : null;
    if (this.orbit.approach(tool, wall)) this.isStale = true;
  }

  /** Draw with fewer pixels while a slow machine plays, and with all when it rests. */
  adapt(wall) {
    const { painter } = this;
    this.pace = 0.9 * this.pace + 0.1 * Math.min(wall, 1);
    this.calm = this.isStale || this.playing ? 0 : this.calm + wall;
    this.waited = (this.waited ?? 0) + wall;
    if (this.playing && this.waited > PATIENCE_S) {
      if (this.pace > SLOWEST_S) this.level = Math.min(this.level + 1, COARSENESS.length - 1);
      else if (this.pace < SLOWEST_S / 3) this.level = Math.max(this.level - 1, 0);
      this.waited = 0;
    }
    // without a graphics processor there are no smooth edges: a picture that rests gets four times the pixels
    const wanted = this.calm > PATIENCE_S ? (painter.isSoftware ? 0.5 : 1) : COARSENESS[this.level];
    if (painter.coarseness === wanted || (wanted > painter.coarseness && !this.isStale)) return;
    Object.assign(painter, { coarseness: wanted });
    this.isStale = true;
  }

  draw() {
    const { motion, painter, factor } = this, place = motion.at(this.time), tool = motion.tool(this.truth, place, factor);
    const models = (which) => this.run.carriers.flatMap((_, body) => matrixOf(...motion.pose(which, body, place, factor)));
    painter.drawScene((aspect) => this.orbit.view(aspect), models(this.truth));
    if (byId("trail").checked) this.drawTrail(place[0], factor);
    if (this.truth === "true" && byId("ghost").checked) painter.drawOutline(models("believed"));
    const size = motion.sizeOfForce(place);
    if (size > this.run.looks.arrow.least_N) painter.drawForce(tool, motion.forceAt(place), size);
    this.tell(place, size);
    this.isStale = false;
    this.drawn += 1;
  }

  /** Draw the trail of the present tool. Its points are computed and uploaded again only for another factor. */
  drawTrail(frame, factor) {
    if (this.trailFactor !== factor) {
      this.trailFactor = factor;
      this.points = [];
      this.pointsUntil = Array.from({ length: this.motion.count }, (_, k) => {
        const tool = this.motion.tool(this.truth, [k, 0], factor), last = this.points.slice(-3);
        const isFirst = this.motion.trailStart[k] === k;
        if (isFirst || Math.hypot(...minus(tool, last)) > this.run.looks.trail_step_m) this.points.push(...tool);
        return this.points.length / 3;
      });
      this.painter.setLine(new Float32Array(this.points));
    }
    const first = this.pointsUntil[this.motion.trailStart[frame]] - 1;
    this.painter.drawLine(first, this.pointsUntil[frame]);
  }

  tell([frame], force) {
    byId("slider").value = (this.time - this.start) / this.span;
    tell("clock", this.time.toFixed(1) + " of " + this.end.toFixed(1) + " s");
    tell("factor", this.factor.toFixed(this.factor < 10 ? 1 : 0));
    const error = this.toolError ? ", tool error " + this.toolError[frame].toFixed(1) + " mm" : "";
    const scale = this.factor > 1.05 ? `, deflection × ${this.factor.toFixed(0)}` : "";
    tell("readout", this.run.modes[frame] + (this.motion.offsets.true ? ", contact " + force.toFixed(1) + " N" : "") + error + scale);
    const time = this.pointed ?? this.time, [row, share] = this.motion.at(time);
    this.plots.forEach((plot) => plot.mark(time, share > 0.5 ? row + 1 : row));
    tell("at", "Values at " + time.toFixed(1) + " s" + (this.pointed == null ? "" : ", under the pointer"));
    const next = this.rows.findIndex(([start]) => start > this.time + 1e-6), present = (next < 0 ? this.rows.length : next) - 1;
    if (present !== this.present) this.markEvent(present);
  }

  /** Mark the present event, and bring it into view in its list. */
  markEvent(present) {
    this.rows[this.present]?.[1].classList.remove("now");
    const button = this.rows[present]?.[1], list = byId("events");
    if (button) {
      button.classList.add("now");
      list.scrollTop = button.offsetTop - list.offsetTop - (list.clientHeight - button.offsetHeight) / 2;
    }
    this.present = present;
  }

  loop(now, last) {
    const wall = (now - last) / 1000;
    this.advance(wall);
    this.approach(wall);
    this.adapt(wall);
    if (this.isStale) this.draw();
    requestAnimationFrame((next) => this.loop(next, now));
  }
}

function describe(run) {
  for (const [name, value] of run.facts) {
    const row = element("div");
    row.append(element("dt", { textContent: name }), element("dd", { textContent: value, title: value }));
    byId("facts").append(row);
  }
  for (const note of run.notes) byId("notes").append(element("li", { textContent: note }));
}

async function main() {
  const run = JSON.parse(byId("run").textContent);
  describe(run);
  try {
    window.player = new Player(run, await unpack(run));
    const now = performance.now();
    window.player.loop(now, now);
  } catch (error) {
    byId("readout").textContent = error.message;
    throw error;
  }
}

main();
