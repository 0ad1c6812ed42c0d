// Scene of a run: poses of the rigid arm over time, offsets of the true and the believed arm that it magnifies, drawing
// and camera. It needs WebGL 2, no library and no network.
"use strict";

const SUN = [0.45, -0.55, 1.0];

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
    Object.assign(this, { gl, looks: run.looks, coarseness: 1 });
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
    this.arrow = this.meshOf(...arrowTriangles(run.looks.arrow));
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
    gl.polygonOffset(0, 1000); // coincide: within 2 cm at a distance of 4 m, by 1000 steps of a depth of 24 bits
    matrices.forEach((matrix, body) => this.draw(this.bodies[body], matrix, [...this.looks.rgb.ghost, 0.75], 2));
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.disable(gl.BLEND);
  }

  /** Take the points of the line. */
  setLine(points) {
    const gl = this.gl;
    gl.bindVertexArray(this.line);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
  }

  /** Draw the points of the line from one index to before another. */
  drawLine(first, end) {
    const gl = this.gl;
    gl.bindVertexArray(this.line);
    gl.uniformMatrix4fv(this.place.model, false, matrixOf([0, 0, 0], [0, 0, 0, 1]));
    gl.uniform4fv(this.place.tint, [...this.looks.rgb.trail, 1]);
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

/** Return the triangles of an arrow of length 1 along x; a quarter is its head. */
function arrowTriangles({ radius_m: shaft, head_m: head }) {
  const p = [], faces = [], n = 12;
  for (const [[x0, r0], [x1, r1]] of [[[0, shaft], [0.75, shaft]], [[0.75, shaft], [0.75, head]], [[0.75, head], [1, 0]]]) {
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
