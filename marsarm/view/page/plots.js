// Plots of a run: values under the pointer, a range of time that all plots share, and a choice of curves.
"use strict";

const MARGIN = { left: 46, right: 8, top: 6, bottom: 18 }; // around a plot, for numbers of five digits
const DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3], [1, 3]]; // curves differ in more than colour
const DARK = matchMedia("(prefers-color-scheme: dark)");
const LEAST_DRAG_PX = 6; // shorter ones are clicks

const byId = (id) => document.getElementById(id);
const element = (tag, properties = {}) => Object.assign(document.createElement(tag), properties);
const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Get a canvas ready for drawing in CSS pixels, and return its context, width and height. */
function sheet(canvas) {
  const ratio = window.devicePixelRatio || 1, { clientWidth: width, clientHeight: height } = canvas;
  Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  return [context, width, height];
}

/** Return two to five round values between two, with as many digits as they need. */
function ticksBetween(start, end) {
  const half = (end - start) / 2, power = 10 ** Math.floor(Math.log10(half) + 1e-9);
  const step = power * [5, 2, 1].find((factor) => factor * power <= half * (1 + 1e-9)), first = Math.ceil(start / step - 1e-9);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return Array.from({ length: Math.floor(end / step + 1e-9) - first + 1 }, (_, k) => fixed(step * (first + k), digits));
}

/** Write a number with so many digits; zero has no sign. */
const fixed = (value, digits) => value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1");

class Plot {
  constructor(plot, arrays, player) {
    Object.assign(this, { plot, player, series: plot.series.map((name) => arrays[name]), shown: plot.series.map(() => true) });
    const figure = element("figure"), caption = element("figcaption");
    caption.append(element("strong", { textContent: plot.title + ", " + plot.unit }));
    this.labels = plot.labels.map((label, i) => {
      const button = element("button", { type: "button", className: "curve", title: "Show or hide; with Shift, show only this" });
      const line = element("i"), value = element("output");
      button.append(line, label + " ", value);
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", (e) => this.choose(i, e.shiftKey));
      caption.append(button);
      return { button, line, value };
    });
    this.canvas = element("canvas");
    this.cursor = element("div", { className: "cursor" });
    this.area = element("div", { className: "area" });
    const frame = element("div");
    frame.append(this.canvas, this.area, this.cursor);
    figure.append(caption, frame);
    byId("plots").append(figure);
    this.listen();
  }

  listen() {
    const { canvas, player } = this;
    canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); this.from = e.offsetX; });
    canvas.addEventListener("pointermove", (e) => {
      player.point(this.timeAt(e.offsetX));
      if (this.from !== undefined) this.cover(this.from, e.offsetX);
    });
    canvas.addEventListener("pointerup", (e) => {
      const from = this.from;
      this.cover(0, 0);
      this.from = undefined;
      if (from === undefined) return;
      if (Math.abs(e.offsetX - from) < LEAST_DRAG_PX) player.seek(this.timeAt(e.offsetX));
      else player.show(...[from, e.offsetX].map((x) => this.timeAt(x)).sort((a, b) => a - b));
    });
    canvas.addEventListener("pointercancel", () => { this.from = undefined; this.cover(0, 0); });
    canvas.addEventListener("pointerleave", () => player.point(null));
    canvas.addEventListener("dblclick", () => player.show());
  }

  /** Cover the part of the plot between two places of the pointer. */
  cover(from, to) {
    Object.assign(this.area.style, { left: Math.min(from, to) + "px", width: Math.abs(to - from) + "px" });
  }

  choose(i, isAlone) {
    if (isAlone) this.shown = this.shown.map((_, k) => k === i);
    else this.shown[i] = !this.shown[i];
    this.labels.forEach(({ button }, k) => button.setAttribute("aria-pressed", String(this.shown[k])));
    this.layOut();
  }

  timeAt(x) {
    const [start, end] = this.player.range;
    return start + Math.min(Math.max((x - MARGIN.left) / this.width, 0), 1) * (end - start);
  }

  /** Return the least and the largest value of the curves that are shown, in the range of time. */
  bounds([first, last]) {
    let low = Infinity, high = -Infinity;
    this.series.forEach((values, i) => {
      if (this.shown[i]) for (let k = first; k <= last; k++) if (Number.isFinite(values[k])) { low = Math.min(low, values[k]); high = Math.max(high, values[k]); }
    });
    return low > high ? [0, 0] : [low, high];
  }

  layOut() {
    const { player } = this, [context, width, height] = sheet(this.canvas), { left, top } = MARGIN;
    const right = width - MARGIN.right, base = height - MARGIN.bottom, [start, end] = player.range, rows = player.rowsBetween(start, end);
    const [least, most] = this.bounds(rows), isFlat = least === most;
    // a curve without a change stands in the middle, beside its value: it has no scale
    const pad = isFlat ? 1 : 0.04 * (most - least), [low, high] = [least - pad, most + pad];
    this.width = right - left;
    const x = (t) => left + ((t - start) / (end - start)) * this.width, y = (v) => top + ((high - v) / (high - low)) * (base - top);
    const line = (...ends) => { context.beginPath(); ends.forEach((point) => context.lineTo(...point)); context.stroke(); };
    Object.assign(context, { strokeStyle: style("--rule"), fillStyle: style("--faint"), font: "11px system-ui, sans-serif", textAlign: "right" });
    context.strokeRect(left - 0.5, top - 0.5, this.width + 1, base - top + 1);
    for (const level of isFlat ? [String(Number(least.toPrecision(4)))] : ticksBetween(least, most)) {
      line([left, y(level)], [right, y(level)]);
      context.fillText(level, left - 4, y(level) + 4);
    }
    context.textAlign = "center";
    for (const tick of ticksBetween(start, end)) {
      line([x(tick), base], [x(tick), base + 3]);
      context.fillText(tick + " s", Math.min(x(tick), right - 12), height - 2);
    }
    context.setLineDash([2, 4]);
    for (const [time] of player.run.events) if (time > start && time < end) line([x(time), top], [x(time), base]);
    this.drawCurves(context, rows, x, y, [top, base]);
    Object.assign(this.cursor.style, { top: top + "px", height: base - top + "px" });
    Object.assign(this.area.style, { top: top + "px", height: base - top + "px" });
  }

  /** Draw the curves; of the rows in one column of pixels only the first, the last and the outermost. */
  drawCurves(context, [first, last], x, y, [top, base]) {
    const colours = this.player.run.looks.curves[DARK.matches ? "dark" : "light"], time = this.player.motion.time;
    context.save();
    context.beginPath();
    context.rect(MARGIN.left, top, this.width, base - top);
    context.clip();
    this.series.forEach((values, i) => {
      const dash = DASHES[i % DASHES.length], colour = colours[i % colours.length];
      this.labels[i].line.style.background = `repeating-linear-gradient(90deg, ${stripes(dash, colour)})`;
      if (!this.shown[i]) return;
      Object.assign(context, { strokeStyle: colour, lineWidth: 1.5 });
      context.setLineDash(dash);
      context.beginPath();
      for (let k = first; k <= last;) {
        const column = Math.floor(x(time[k]));
        let low = k, high = k, end = k;
        for (; end <= last && Math.floor(x(time[end])) === column; end++) { if (values[end] < values[low]) low = end; if (values[end] > values[high]) high = end; }
        for (const row of [k, Math.min(low, high), Math.max(low, high), end - 1]) if (Number.isFinite(values[row])) context.lineTo(x(time[row]), y(values[row]));
        k = end;
      }
      context.stroke();
    });
    context.restore();
  }

  /** Show a time, and the values there. */
  mark(time, frame) {
    const [start, end] = this.player.range, share = (time - start) / (end - start), digits = this.plot.unit === "A" ? 2 : 1;
    this.cursor.hidden = share < 0 || share > 1;
    this.cursor.style.transform = `translateX(${Math.round(MARGIN.left + share * this.width)}px)`;
    this.labels.forEach(({ value }, i) => tellIn(value, fixed(this.series[i][frame], digits)));
  }
}

/** Return the stops of a gradient that looks like a dashed line. */
function stripes(dash, colour) {
  let at = 0;
  const parts = dash.length ? dash : [8, 0];
  return parts.map((length, i) => { const from = at; at += length; return `${i % 2 ? "transparent" : colour} ${from}px ${at}px`; }).join(", ");
}

/** Write a text where it has changed. */
function tellIn(node, text) {
  if (node.textContent !== text) node.textContent = text;
}
