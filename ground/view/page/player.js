// Player of a run: poses of the rigid arm over time, and offsets of the true and the believed arm that it magnifies.
// It needs WebGL 2, no library and no network.
"use strict";

const byId = (id) => document.getElementById(id);
const SPEEDS = [1, 2, 5, 10, 20, 50];
const SUN = [0.45, -0.55, 1.0];
const GHOST_RGB = [0.16, 0.45, 0.95];
const ARROW_RGB = [0.9, 0.12, 0.1];
const TRAIL_RGB = [1.0, 0.85, 0.1];
const TRAIL_STEP_M = 0.01;
const SLOWEST_S = 1 / 24;
const COARSEST = 2.5;
const ARROW_M_PER_N = 0.006;
const ARROW_WIDTH_M = 0.4;
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

// ---- rotations and matrices (column major, quaternions x, y, z, w) -----------------------------------------------------

function multiplyQuaternions([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

function quaternionOf([x, y, z]) {
  const angle = Math.hypot(x, y, z);
  const s = angle < 1e-9 ? 0.5 : Math.sin(angle / 2) / angle;
  return [x * s, y * s, z * s, Math.cos(angle / 2)];
}

function matrixOf(p, [x, y, z, w], scale = 1) {
  const s = scale;
  return [
    s * (1 - 2 * (y * y + z * z)), s * 2 * (x * y + z * w), s * 2 * (x * z - y * w), 0,
    s * 2 * (x * y - z * w), s * (1 - 2 * (x * x + z * z)), s * 2 * (y * z + x * w), 0,
    s * 2 * (x * z + y * w), s * 2 * (y * z - x * w), s * (1 - 2 * (x * x + y * y)), 0,
    p[0], p[1], p[2], 1,
  ];
}

function multiply(a, b) {
  const out = new Array(16).fill(0);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
  return out;
}

const minus = (a, b) => a.map((v, i) => v - b[i]);
const plus = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((v) => v / n); };

// ---- poses -------------------------------------------------------------------------------------------------------------

/** Poses over time. A time between two frames gives poses between theirs. */
class Motion {
  constructor(run, arrays) {
    Object.assign(this, { count: run.frames, bodies: run.bodies, time: arrays.time, p: arrays.p, q: arrays.q });
    this.offsets = { true: arrays.true, believed: arrays.believed };
    Object.assign(this, { force: arrays.force, trailStart: arrays["trail start"] });
  }

  /** Return the frame at or before a time, and the share of the way to the next one. */
  at(time) {
    let low = 0, high = this.count - 1;
    while (high - low > 1) { const middle = (low + high) >> 1; if (this.time[middle] <= time) low = middle; else high = middle; }
    const span = this.time[high] - this.time[low];
    return [low, span > 0 ? Math.min(Math.max((time - this.time[low]) / span, 0), 1) : 0];
  }

  between(values, width, index, [frame, share]) {
    const a = (frame * this.bodies + index) * width;
    const b = frame + 1 < this.count ? a + this.bodies * width : a;
    const out = new Array(width);
    for (let i = 0; i < width; i++) out[i] = values[a + i] + share * (values[b + i] - values[a + i]);
    return out;
  }

  /** Return position and quaternion of a body of one arm with its offset times a factor. */
  pose(which, body, place, factor) {
    const offset = this.between(this.offsets[which], 6, body, place);
    const q = unit(this.between(this.q, 4, body, place));
    const p = plus(this.between(this.p, 3, body, place), offset, factor);
    return [p, multiplyQuaternions(quaternionOf(offset.slice(3).map((v) => factor * v)), q)];
  }

  tool(which, place, factor) { return this.pose(which, this.bodies - 1, place, factor)[0]; }

  forceAt([frame, share]) {
    const a = 3 * frame, b = frame + 1 < this.count ? a + 3 : a;
    return [0, 1, 2].map((i) => this.force[a + i] + share * (this.force[b + i] - this.force[a + i]));
  }
}

// ---- drawing -----------------------------------------------------------------------------------------------------------

const VERTEX = `#version 300 es
layout(location=0) in vec3 p; layout(location=1) in vec3 n; layout(location=2) in vec3 c;
uniform mat4 model, view; uniform float size; out vec3 normal, colour; out float depth;
void main() { vec4 w = model * vec4(p, 1.0); gl_Position = view * w; gl_PointSize = size;
  normal = mat3(model) * n; colour = c; depth = gl_Position.w; }`;
const FRAGMENT = `#version 300 es
precision mediump float; in vec3 normal, colour; in float depth;
uniform vec4 tint; uniform vec3 sun; uniform float lit; out vec4 outColour;
void main() { vec3 rgb = mix(colour, tint.rgb, tint.a);
  vec3 n = normalize(normal + vec3(0.0, 0.0, 1e-6)); if (!gl_FrontFacing) n = -n;
  float light = mix(1.0, 0.50 + 0.14 * n.z + 0.52 * max(dot(n, sun), 0.0), step(0.5, lit));
  rgb = mix(vec3(0.84, 0.70, 0.55), rgb * light, exp(-depth / 150.0));
  float alpha = lit > 1.5 ? 0.42 : 1.0; outColour = vec4(rgb * alpha, alpha); }`;

class Painter {
  constructor(canvas, run, arrays) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", { antialias: !isSoftware(), alpha: true });
    if (!gl) throw new Error("This browser has no WebGL 2, which the scene needs.");
    this.gl = gl;
    this.coarseness = 1;
    this.program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.program));
    gl.useProgram(this.program);
    this.place = Object.fromEntries(["model", "view", "tint", "sun", "lit", "size"].map((n) => [n, gl.getUniformLocation(this.program, n)]));
    gl.uniform3fv(this.place.sun, unit(SUN));
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.bodies = run.carriers.map((_, body) => this.mesh(arrays, run.parts.filter((part) => part.carrier === body)));
    this.still = this.mesh(arrays, run.parts.filter((part) => part.carrier < 0));
    this.arrow = this.meshOf(...arrowTriangles());
    this.line = gl.createVertexArray();
    this.lineBuffer = gl.createBuffer();
  }

  /** Make one mesh of parts of several colours. */
  mesh(arrays, parts) {
    const p = [], c = [], faces = [];
    for (const { vertices: [start, count], faces: [first, length], rgb } of parts) {
      const base = p.length / 3;
      for (let i = 3 * start; i < 3 * (start + count); i++) p.push(arrays.vertices[i]);
      for (let i = 0; i < count; i++) c.push(...rgb);
      for (let i = 3 * first; i < 3 * (first + length); i++) faces.push(base + arrays.faces[i]);
    }
    return this.meshOf(p, c, faces);
  }

  meshOf(p, c, faces) {
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    [p, normalsOf(p, faces), c].forEach((values, location) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, gl.FLOAT, false, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(faces), gl.STATIC_DRAW);
    return { array, count: faces.length };
  }

  begin(view) {
    const gl = this.gl, ratio = Math.min(window.devicePixelRatio || 1, 2) / this.coarseness;
    const width = Math.round(this.canvas.clientWidth * ratio), height = Math.round(this.canvas.clientHeight * ratio);
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.place.view, false, view(width / height));
    gl.uniform1f(this.place.size, Math.max(3 * ratio, 2));
  }

  draw(mesh, matrix, tint = [0, 0, 0, 0], lit = 1) {
    const gl = this.gl;
    gl.uniformMatrix4fv(this.place.model, false, matrix);
    gl.uniform4fv(this.place.tint, tint);
    gl.uniform1f(this.place.lit, lit);
    gl.bindVertexArray(mesh.array);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
  }

  /** Draw an arm that lets the scene behind show through. */
  drawGhost(matrices) {
    const gl = this.gl;
    gl.enable(gl.BLEND);
    gl.enable(gl.POLYGON_OFFSET_FILL); // where both arms coincide, the true one is seen
    gl.polygonOffset(0, 1000);
    matrices.forEach((matrix, body) => this.draw(this.bodies[body], matrix, [...GHOST_RGB, 0.75], 2));
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.disable(gl.BLEND);
  }

  /** Draw the points from one index to before another. */
  drawLine(points, first, end) {
    const gl = this.gl;
    gl.bindVertexArray(this.line);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.uniformMatrix4fv(this.place.model, false, matrixOf([0, 0, 0], [0, 0, 0, 1]));
    gl.uniform4fv(this.place.tint, [...TRAIL_RGB, 1]);
    gl.uniform1f(this.place.lit, 0);
    gl.drawArrays(gl.LINE_STRIP, first, end - first);
    gl.drawArrays(gl.POINTS, first, end - first);
  }
}

/** Return whether WebGL is computed without a graphics processor: then smooth edges cost too much. */
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const about = gl && gl.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|software/i.test(about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : "");
}

/** Compute normals of vertices as the sum of the normals of their triangles by area. */
function normalsOf(p, faces) {
  const normals = new Float32Array(p.length);
  const at = (k) => [p[3 * k], p[3 * k + 1], p[3 * k + 2]];
  for (let i = 0; i < faces.length; i += 3) {
    const corners = [faces[i], faces[i + 1], faces[i + 2]];
    const [a, b, c] = corners.map(at);
    const n = cross(minus(b, a), minus(c, a));
    for (const corner of corners) for (let k = 0; k < 3; k++) normals[3 * corner + k] += n[k];
  }
  for (let i = 0; i < normals.length; i += 3) {
    const size = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[i + k] /= size;
  }
  return normals;
}

/** Return the triangles of an arrow of length 1 along x. */
function arrowTriangles() {
  const p = [], faces = [], n = 12;
  for (const [[x0, r0], [x1, r1]] of [[[0, 0.03], [0.75, 0.03]], [[0.75, 0.03], [0.75, 0.08]], [[0.75, 0.08], [1, 0]]]) {
    const base = p.length / 3;
    for (let i = 0; i <= n; i++) {
      const angle = (2 * Math.PI * i) / n, c = Math.cos(angle), s = Math.sin(angle);
      p.push(x0, r0 * c, r0 * s, x1, r1 * c, r1 * s);
      if (i < n) faces.push(...[0, 2, 1, 2, 3, 1].map((corner) => base + 2 * i + corner));
    }
  }
  return [p, p.map(() => 0), faces];
}

// ---- camera ------------------------------------------------------------------------------------------------------------

/** Camera that turns about a point: drag turns, two fingers or the right button move, the wheel zooms. */
class Orbit {
  constructor(canvas, target) {
    Object.assign(this, { canvas, target, azimuth: -0.8, height: 0.34, distance: 4.1, pointers: new Map() });
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); this.pointers.set(e.pointerId, [e.clientX, e.clientY, e.button]); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener("pointermove", (e) => this.drag(e));
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom(Math.exp(e.deltaY * 0.001)); }, { passive: false });
  }

  drag(e) {
    const last = this.pointers.get(e.pointerId);
    if (!last) return;
    const [x, y, button] = last, dx = e.clientX - x, dy = e.clientY - y;
    const others = [...this.pointers].filter(([id]) => id !== e.pointerId).map(([, other]) => other);
    this.pointers.set(e.pointerId, [e.clientX, e.clientY, button]);
    if (others.length) {
      const [ox, oy] = others[0];
      this.zoom(Math.hypot(x - ox, y - oy) / Math.max(Math.hypot(e.clientX - ox, e.clientY - oy), 1));
    }
    if (others.length || button === 2) {
      const { right, up } = this.axes(), step = (this.distance * 0.7) / this.canvas.clientHeight / (others.length + 1);
      this.target = plus(plus(this.target, right, -dx * step), up, dy * step);
    } else {
      this.azimuth -= dx * 0.006;
      this.height = Math.min(Math.max(this.height + dy * 0.006, -0.1), 1.55);
    }
  }

  zoom(factor) { this.distance = Math.min(Math.max(this.distance * factor, 0.3), 40); }

  axes() {
    const back = [Math.cos(this.height) * Math.cos(this.azimuth), Math.cos(this.height) * Math.sin(this.azimuth), Math.sin(this.height)];
    const right = unit(cross([0, 0, 1], back));
    return { back, right, up: cross(back, right) };
  }

  view(aspect) {
    const { back, right, up } = this.axes(), eye = plus(this.target, back, this.distance);
    // a narrow screen sees as far to the sides as a square one
    const f = 1 / Math.tan(0.37) * Math.min(1, Math.max(aspect, 0.45)), near = 0.05, far = 400;
    const look = [0, 1, 2].flatMap((i) => [right[i], up[i], back[i], 0]).concat([-dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
    const lens = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
    return multiply(lens, look);
  }
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
    this.canvas.addEventListener("pointerdown", (e) => player.seek(player.start + (e.offsetX / this.canvas.clientWidth) * player.span));
  }

  layOut() {
    const colours = style("--joints").split(/,\s*/), { time, count } = this.player.motion;
    this.caption.querySelectorAll("span").forEach((item) => { item.style.color = colours[item.dataset.colour]; });
    const [context, width, height] = sheet(this.canvas);
    let low = Infinity, high = -Infinity;
    for (const values of this.series) for (const value of values) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
    if (!(high > low)) [low, high] = [low - 1 || -1, high + 1 || 1];
    const x = (t) => ((t - this.player.start) / this.player.span) * width, y = (v) => 4 + ((high - v) / (high - low)) * (height - 8);
    context.strokeStyle = style("--rule");
    context.strokeRect(0.5, 0.5, width - 1, height - 1);
    if (low < 0 && high > 0) { context.beginPath(); context.moveTo(0, y(0)); context.lineTo(width, y(0)); context.stroke(); }
    this.series.forEach((values, i) => {
      context.strokeStyle = colours[i % colours.length];
      context.lineWidth = 1.3;
      context.beginPath();
      for (let k = 0; k < count; k++) context.lineTo(x(time[k]), y(values[k]));
      context.stroke();
    });
    context.fillStyle = style("--faint");
    context.font = "11px system-ui, sans-serif";
    const digits = Math.max(0, 2 - Math.floor(Math.log10(high - low)));
    context.fillText(high.toFixed(digits), 4, 13);
    context.fillText(low.toFixed(digits), 4, height - 5);
    this.width = width;
  }

  mark(share) { this.cursor.style.transform = `translateX(${Math.round(share * this.width)}px)`; }
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
    for (const speed of SPEEDS) byId("speed").append(new Option(speed + "×", speed, false, speed === 10));
    byId("play").addEventListener("click", () => this.toggle());
    byId("slider").addEventListener("input", () => this.seek(this.start + byId("slider").value * this.span));
    byId("magnify").max = Math.log(this.run.magnification);
    for (const id of ["magnify", "ghost", "trail", "follow"]) byId(id).addEventListener("input", again);
    for (const name of ["pointermove", "wheel"]) byId("scene").addEventListener(name, again);
    if (this.truth === "believed") byId("ghost").closest("label").hidden = true;
    window.addEventListener("resize", () => this.layOut());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.layOut());
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
    if (size > 0.05) this.drawArrow(tool, force, size);
    if (this.truth === "true" && byId("ghost").checked) painter.drawGhost(matrices("believed"));
    this.tell(place, size);
    this.isStale = false;
    this.drawn += 1;
  }

  drawArrow(tool, force, size) {
    const length = Math.min(0.1 + ARROW_M_PER_N * size, 0.8), x = force.map((v) => v / size);
    const y = unit(cross(Math.abs(x[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0], x)), z = cross(x, y);
    const columns = [[x, length], [y, ARROW_WIDTH_M], [z, ARROW_WIDTH_M]].flatMap(([axis, s]) => [...axis.map((v) => v * s), 0]);
    const { gl } = this.painter;
    gl.disable(gl.DEPTH_TEST); // the arrow begins inside the tool
    this.painter.draw(this.painter.arrow, [...columns, ...tool, 1], [...ARROW_RGB, 1], 0);
    gl.enable(gl.DEPTH_TEST);
  }

  /** Draw the trail of the present tool. Its points are TRAIL_STEP_M apart, computed again only for another factor. */
  drawTrail(frame, factor) {
    if (this.trailFactor !== factor) {
      this.trailFactor = factor;
      this.points = [];
      this.pointsUntil = Array.from({ length: this.motion.count }, (_, k) => {
        const tool = this.motion.tool(this.truth, [k, 0], factor), last = this.points.slice(-3);
        const isFirst = this.motion.trailStart[k] === k;
        if (isFirst || Math.hypot(...minus(tool, last)) > TRAIL_STEP_M) this.points.push(...tool);
        return this.points.length / 3;
      });
      this.points = new Float32Array(this.points);
    }
    const first = this.pointsUntil[this.motion.trailStart[frame]] - 1;
    this.painter.drawLine(this.points, first, this.pointsUntil[frame]);
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
