// Scene of a run: poses of the rigid arm over time, offsets of the true and the believed arm that it magnifies,
// and camera. No part of the page needs a library or the network.
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

  sizeOfForce(place) { return Math.hypot(...this.forceAt(place)); }
}

// ---- camera ------------------------------------------------------------------------------------------------------------

const NEAR_M = 1.3; // from the tool: it fills a fifth of the picture's height
const SETTLING_S = 0.35; // time in which the camera goes most of the way

/** Camera about a point: drag turns, two fingers or the right button move, the wheel zooms. */
class Orbit {
  constructor(canvas, target) {
    Object.assign(this, { canvas, home: target, target, azimuth: -0.8, height: 0.34, pointers: new Map(), isFree: false });
    this.reach = { far: 4.1, near: NEAR_M };
    this.distance = this.reach.far;
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); this.pointers.set(e.pointerId, [e.clientX, e.clientY, e.button]); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener("pointermove", (e) => this.drag(e));
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom(Math.exp(e.deltaY * 0.001)); }, { passive: false });
  }

  /** Approach the tool, or the view of all, for a wall time; return whether the camera still moves. */
  approach(tool, wall) {
    if (this.isFree) return false;
    this.place = tool ? "near" : "far";
    const share = 1 - Math.exp(-wall / SETTLING_S), to = tool || this.home, way = minus(to, this.target);
    const zoom = Math.log(this.reach[this.place] / this.distance);
    if (Math.hypot(...way) < 1e-3 && Math.abs(zoom) < 1e-3) return false;
    this.target = plus(this.target, way, share);
    this.distance *= Math.exp(share * zoom);
    return true;
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
      this.isFree = true;
    } else {
      this.azimuth -= dx * 0.006;
      this.height = Math.min(Math.max(this.height + dy * 0.006, 0.02), 1.55);
    }
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 0.3), 40);
    this.reach[this.place] = this.distance;
  }

  axes() {
    const back = [Math.cos(this.height) * Math.cos(this.azimuth), Math.cos(this.height) * Math.sin(this.azimuth), Math.sin(this.height)];
    const right = unit(cross([0, 0, 1], back));
    return { back, right, up: cross(back, right) };
  }

  view(aspect) {
    const { back, right, up } = this.axes(), eye = plus(this.target, back, this.distance);
    // a screen narrower than 5 : 3 sees as far to the sides as one of 5 : 3
    const f = 1 / Math.tan(0.37) * Math.min(1, aspect * 0.6), near = 0.05, far = 400;
    const lens = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
    return multiply(lens, lookFrom(eye, right, up, back));
  }
}

/** Return the matrix from the world to axes at an eye. */
function lookFrom(eye, right, up, back) {
  return [0, 1, 2].flatMap((i) => [right[i], up[i], back[i], 0]).concat([-dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
}

/** Return the matrix from the world to a cube of side 2 around a sphere, as the sun sees it. */
function sunView(centre, radius) {
  const back = unit(SUN), right = unit(cross([0, 0, 1], back)), s = 1 / radius;
  return multiply([s, 0, 0, 0, 0, s, 0, 0, 0, 0, -s, 0, 0, 0, 0, 1], lookFrom(centre, right, cross(back, right), back));
}
