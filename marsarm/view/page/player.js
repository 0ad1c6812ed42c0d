// Player of a run: plots, event reports, time line and controls around the scene of scene.js.

const byId = (id) => document.getElementById(id);
const SLOWEST_S = 1 / 24; // longer frames than those of a film do not look smooth
const COARSEST = 2.5; // in pixels of the screen: a link, 0.1 m, is still 7 pixels wide in the first view
const MARGIN = { left: 40, right: 6, top: 6, bottom: 16 }; // around a plot, for numbers of five digits
const DARK = matchMedia("(prefers-color-scheme: dark)");
const SEVERITY_CLASS = (severity) => (severity >= 5 ? "bad" : severity >= 4 ? "warn" : "");

// ---- data ------------------------------------------------------------------------------------------------------------

/** Unpack the arrays of the page: one gzip stream, in which `run.arrays` gives type, start and length of each. */
async function unpack(run) {
  const packed = Uint8Array.from(atob(byId("data").textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = await new Response(stream).arrayBuffer();
  const types = { f4: Float32Array, u4: Uint32Array };
  return Object.fromEntries(run.arrays.map(([name, type, at, length]) => [name, new types[type](bytes, at, length)]));
}

// ---- plots, events ---------------------------------------------------------------------------------------------------------

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Get a canvas ready for drawing in CSS pixels, and return its context, width and height. */
function sheet(canvas) {
  const ratio = window.devicePixelRatio || 1, { clientWidth: width, clientHeight: height } = canvas;
  Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  return [context, width, height];
}

class Plot {
  constructor(plot, arrays, player) {
    Object.assign(this, { plot, player, series: plot.series.map((name) => arrays[name]) });
    const figure = document.createElement("figure"), caption = document.createElement("figcaption");
    caption.append(Object.assign(document.createElement("strong"), { textContent: plot.title + ", " + plot.unit }));
    plot.labels.forEach((label, i) => {
      const item = Object.assign(document.createElement("span"), { textContent: label });
      item.dataset.colour = i;
      caption.append(item);
    });
    this.caption = caption;
    this.canvas = document.createElement("canvas");
    this.cursor = document.createElement("div");
    this.cursor.className = "cursor";
    const frame = document.createElement("div");
    frame.append(this.canvas, this.cursor);
    figure.append(caption, frame);
    byId("plots").append(figure);
    this.canvas.addEventListener("pointerdown", (e) => player.seek(player.start + ((e.offsetX - this.left) / this.width) * player.span));
  }

  layOut() {
    const colours = this.player.run.looks.curves[DARK.matches ? "dark" : "light"], { time, count } = this.player.motion;
    this.caption.querySelectorAll("span").forEach((item) => { item.style.color = colours[item.dataset.colour]; });
    const [context, width, height] = sheet(this.canvas);
    let low = Infinity, high = -Infinity;
    for (const values of this.series) for (const value of values) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
    if (low > high) [low, high] = [0, 0]; // no value is finite
    if (low === high) [low, high] = [low - 1, high + 1];
    const right = width - MARGIN.right, base = height - MARGIN.bottom, { left, top } = MARGIN;
    const x = (t) => left + ((t - this.player.start) / this.player.span) * (right - left);
    const y = (v) => top + ((high - v) / (high - low)) * (base - top);
    const line = (...points) => { context.beginPath(); points.forEach(([px, py]) => context.lineTo(px, py)); context.stroke(); };
    Object.assign(context, { strokeStyle: style("--rule"), fillStyle: style("--faint"), font: "11px system-ui, sans-serif" });
    context.strokeRect(left - 0.5, top - 0.5, right - left + 1, base - top + 1);
    const digits = Math.max(0, 2 - Math.floor(Math.log10(high - low)));
    const levels = [high, low].concat(low < 0 && high > 0 && Math.min(y(0) - top, base - y(0)) > 14 ? [0] : []);
    context.textAlign = "right";
    for (const level of levels) {
      context.fillText(level ? level.toFixed(digits) : "0", left - 4, Math.min(Math.max(y(level) + 4, top + 8), base));
      line([left, y(level)], [right, y(level)]);
    }
    context.textAlign = "center";
    for (const tick of ticksBetween(this.player.start, this.player.end)) {
      line([x(tick), base], [x(tick), base + 3]);
      context.fillText(tick + " s", Math.min(x(tick), right - 12), height - 1);
    }
    this.series.forEach((values, i) => {
      Object.assign(context, { strokeStyle: colours[i % colours.length], lineWidth: 1.3 });
      line(...Array.from({ length: count }, (_, k) => [x(time[k]), y(values[k])]));
    });
    Object.assign(this, { left, width: right - left });
    Object.assign(this.cursor.style, { top: top + "px", height: base - top + "px" });
  }

  mark(share) { this.cursor.style.transform = `translateX(${Math.round(this.left + share * this.width)}px)`; }
}

/** Return the round times between two, at most six. */
function ticksBetween(start, end) {
  const least = (end - start) / 5, power = 10 ** Math.floor(Math.log10(least));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= least), first = Math.ceil(start / step);
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  return Array.from({ length: Math.floor(end / step) - first + 1 }, (_, k) => ((first + k) * step).toFixed(digits));
}

function fillEvents(player) {
  player.rows = player.run.events.map(([time, severity, text]) => {
    const item = document.createElement("li"), button = Object.assign(document.createElement("button"), { type: "button" });
    button.className = SEVERITY_CLASS(severity);
    button.append(Object.assign(document.createElement("time"), { textContent: time.toFixed(1) + " s" }), text);
    button.addEventListener("click", () => player.seek(time));
    item.append(button);
    byId("events").append(item);
    return [time, button];
  });
}

function drawMarks(player) {
  const [context, width, height] = sheet(byId("marks"));
  const colour = { "": style("--faint"), warn: style("--warn"), bad: style("--bad") };
  for (const [time, severity] of player.run.events) {
    context.fillStyle = colour[SEVERITY_CLASS(severity)];
    // the thumb of the slider is 16 px wide, and its centre stands at the time
    context.fillRect(8 + ((time - player.start) / player.span) * (width - 16) - 1, severity >= 4 ? 0 : 4, 2, height);
  }
}

// ---- player ------------------------------------------------------------------------------------------------------------

class Player {
  constructor(run, arrays) {
    Object.assign(this, { run, motion: new Motion(run, arrays), playing: false, drawn: 0, isStale: true });
    const { time, count } = this.motion;
    [this.start, this.end, this.time] = [time[0], time[count - 1], time[0]];
    this.span = Math.max(this.end - this.start, 1e-3);
    this.truth = arrays.true ? "true" : "believed";
    this.painter = new Painter(byId("scene"), run, arrays);
    this.orbit = new Orbit(byId("scene"), run.target);
    this.plots = run.plots.map((plot) => new Plot(plot, arrays, this));
    this.modeOf = run.modes;
    this.toolError = arrays["tool error"];
    this.wire();
    fillEvents(this);
    this.layOut();
  }

  wire() {
    const again = () => { this.isStale = true; };
    const { speeds, first_speed: first, magnification } = this.run.looks;
    for (const speed of speeds) byId("speed").append(new Option(speed + "×", speed, false, speed === first));
    byId("play").addEventListener("click", () => this.toggle());
    byId("slider").addEventListener("input", () => this.seek(this.start + byId("slider").value * this.span));
    byId("magnify").max = Math.log(magnification);
    for (const id of ["magnify", "ghost", "trail", "follow"]) byId(id).addEventListener("input", again);
    for (const name of ["pointermove", "wheel"]) byId("scene").addEventListener(name, again);
    if (this.truth === "believed") byId("ghost").closest("label").hidden = true;
    window.addEventListener("resize", () => this.layOut());
    DARK.addEventListener("change", () => this.layOut());
    document.addEventListener("keydown", (e) => {
      if (e.target.matches("input, select, button")) return;
      if (e.key === " ") { e.preventDefault(); this.toggle(); }
      const step = { ArrowLeft: -5, ArrowRight: 5 }[e.key];
      if (step) this.seek(this.time + step);
    });
  }

  layOut() {
    this.plots.forEach((plot) => plot.layOut());
    drawMarks(this);
    this.isStale = true;
  }

  get speed() { return Number(byId("speed").value); }
  get factor() { return Math.exp(byId("magnify").value); }

  toggle() {
    if (!this.playing && this.time >= this.end) this.seek(this.start);
    this.playing = !this.playing;
    byId("play").textContent = this.playing ? "Pause" : "Play";
  }

  seek(time) {
    this.time = Math.min(Math.max(time, this.start), this.end);
    this.isStale = true;
  }

  /** Advance by wall time in seconds at the chosen speed. */
  advance(wall) {
    if (!this.playing) return;
    this.seek(this.time + wall * this.speed);
    if (this.time >= this.end) this.toggle();
  }

  /** Draw with fewer pixels while a slow machine plays, and with all when it rests. */
  adapt(wall) {
    const { painter } = this;
    this.pace = 0.8 * (this.pace ?? wall) + 0.2 * wall;
    if (this.playing && this.pace > SLOWEST_S) painter.coarseness = Math.min(painter.coarseness * 1.05, COARSEST);
    if (!this.playing && painter.coarseness > 1) { painter.coarseness = 1; this.isStale = true; }
  }

  draw() {
    const { motion, painter, factor } = this, place = motion.at(this.time), tool = motion.tool(this.truth, place, factor);
    const matrices = (which) => painter.bodies.map((_, body) => matrixOf(...motion.pose(which, body, place, factor)));
    if (byId("follow").checked) this.orbit.target = tool;
    painter.begin((aspect) => this.orbit.view(aspect));
    // what stands in front comes first: what it hides is not shaded
    matrices(this.truth).forEach((matrix, body) => painter.draw(painter.bodies[body], matrix));
    painter.draw(painter.still, matrixOf([0, 0, 0], [0, 0, 0, 1]));
    if (byId("trail").checked) this.drawTrail(place[0], factor);
    const force = motion.forceAt(place), size = Math.hypot(...force);
    if (size > this.run.looks.arrow.least_N) this.drawArrow(tool, force, size);
    if (this.truth === "true" && byId("ghost").checked) painter.drawGhost(matrices("believed"));
    this.tell(place, size);
    this.isStale = false;
    this.drawn += 1;
  }

  drawArrow(tool, force, size) {
    const { shortest_m: shortest, longest_m: longest, m_per_N: scale } = this.run.looks.arrow;
    const length = Math.min(shortest + scale * size, longest), x = force.map((v) => v / size);
    const y = unit(cross(Math.abs(x[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0], x)), z = cross(x, y);
    const columns = [[x, length], [y, 1], [z, 1]].flatMap(([axis, s]) => [...axis.map((v) => v * s), 0]);
    const { gl } = this.painter;
    gl.disable(gl.DEPTH_TEST); // the arrow begins inside the tool
    this.painter.draw(this.painter.arrow, [...columns, ...tool, 1], [...this.run.looks.rgb.force, 1], 0);
    gl.enable(gl.DEPTH_TEST);
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
    const share = (this.time - this.start) / this.span;
    byId("slider").value = share;
    tell("clock", this.time.toFixed(1) + " of " + this.end.toFixed(1) + " s");
    tell("factor", this.factor.toFixed(this.factor < 10 ? 1 : 0));
    const error = this.toolError ? ", tool error " + this.toolError[frame].toFixed(1) + " mm" : "";
    tell("readout", this.modeOf[frame] + (this.motion.offsets.true ? ", contact " + force.toFixed(1) + " N" : "") + error);
    this.plots.forEach((plot) => plot.mark(share));
    const next = this.rows.findIndex(([time]) => time > this.time), present = (next < 0 ? this.rows.length : next) - 1;
    if (present === this.present) return;
    this.rows[this.present]?.[1].classList.remove("now");
    this.rows[present]?.[1].classList.add("now");
    this.present = present;
  }

  loop(now, last) {
    const wall = (now - last) / 1000;
    this.advance(wall);
    this.adapt(wall);
    if (this.isStale) this.draw();
    requestAnimationFrame((next) => this.loop(next, now));
  }
}

function describe(run) {
  for (const [name, value] of run.facts) {
    const row = document.createElement("div");
    row.append(Object.assign(document.createElement("dt"), { textContent: name }), Object.assign(document.createElement("dd"), { textContent: value, title: value }));
    byId("facts").append(row);
  }
  for (const note of run.notes) byId("notes").append(Object.assign(document.createElement("li"), { textContent: note }));
}

/** Write a text where it has changed. */
function tell(id, text) {
  if (byId(id).textContent !== text) byId(id).textContent = text;
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
