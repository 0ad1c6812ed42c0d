// Interactive traces, one figure a joint with a choice of motions. Drag or buttons zoom; a pointer reads values.
"use strict";
(() => {
  const NS = "http://www.w3.org/2000/svg";
  const HEIGHTS = [220, 130], GAP = 26, LEFT = 58, RIGHT = 14, TOP = 22, BOTTOM = 34, TICKS = 5;
  const BLOCK = 10; // pixels of a line within which it is looked at whether it oscillates
  const OUTER = 0.005; // share of values at each end that may lie outside a panel
  const make = (tag, attributes, parent) => {
    const node = document.createElementNS(NS, tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    parent.append(node);
    return node;
  };
  // Round numbers that divide a range.
  const ticks = (low, high) => {
    const raw = (high - low) / TICKS, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find((factor) => factor * power >= raw);
    const list = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) list.push(k * step);
    return [list, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
  };
  // Range of the values that are seen. A panel in which the outermost values would take two thirds of the height
  // leaves them out; they get a mark at its edge. No panel is narrower than `least`.
  const range = (lists, from, to, least) => {
    const seen = lists.flatMap((list) => list.slice(from, to + 1)).filter((value) => value !== null).sort((a, b) => a - b);
    if (!seen.length) return [0, 1];
    const at = (share) => seen[Math.round(share * (seen.length - 1))];
    let low = at(0), high = at(1);
    const body = Math.max(at(1 - OUTER) - at(OUTER), least);
    if (high - low > 3 * body && body > 0) {
      low = Math.max(low, at(OUTER) - body / 2);
      high = Math.min(high, at(1 - OUTER) + body / 2);
    }
    const room = Math.max(0.05 * (high - low), (least - high + low) / 2, 5e-11);
    return [low - room, high + room];
  };
  // Index of the first time that is not below t.
  const index = (time, t) => {
    let low = 0, high = time.length - 1;
    while (low < high) { const mid = (low + high) >> 1; if (time[mid] < t) low = mid + 1; else high = mid; }
    return low;
  };

  class Figure {
    constructor(box) {
      this.box = box;
      this.motions = JSON.parse(box.querySelector("script").textContent);
      this.svg = make("svg", {role: "img", tabindex: 0, "aria-label": box.dataset.label}, box.querySelector(".plot"));
      this.readout = box.querySelector(".readout");
      this.hidden = new Set();
      this.names = {};
      for (const button of box.querySelectorAll("button[data-series]"))
        this.names[button.dataset.series] = button.textContent;
      this.select = box.querySelector("select");
      this.select.addEventListener("change", () => this.show(Number(this.select.value)));
      for (const button of box.querySelectorAll("button[data-zoom]"))
        button.addEventListener("click", () => this.zoom(Number(button.dataset.zoom)));
      for (const button of box.querySelectorAll("button[data-series]"))
        button.addEventListener("click", () => this.toggle(button));
      this.svg.addEventListener("pointerdown", (event) => this.press(event));
      this.svg.addEventListener("pointermove", (event) => this.move(event));
      this.svg.addEventListener("pointerup", (event) => this.release(event));
      this.svg.addEventListener("pointercancel", () => { this.from = null; this.draw(); });
      this.svg.addEventListener("pointerleave", () => this.point(null));
      this.svg.addEventListener("dblclick", () => this.zoom(0));
      this.svg.addEventListener("keydown", (event) => this.key(event));
      new ResizeObserver(() => this.draw()).observe(this.svg);
      this.show(0);
    }
    show(number) {
      this.motion = this.motions[number];
      this.span = this.whole();
      this.draw();
    }
    whole() { const time = this.motion.time_s; return [time[0], time[time.length - 1]]; }
    toggle(button) {
      const name = button.dataset.series, off = !this.hidden.has(name);
      if (off) this.hidden.add(name); else this.hidden.delete(name);
      button.setAttribute("aria-pressed", String(!off));
      this.draw();
    }
    zoom(factor) {
      const [low, high] = this.whole();
      if (!factor) return this.look(low, high);
      const middle = (this.span[0] + this.span[1]) / 2, half = (this.span[1] - this.span[0]) * factor / 2;
      return this.look(middle - half, middle + half);
    }
    look(from, to) {
      const [low, high] = this.whole(), least = (high - low) / 500;
      const length = Math.min(Math.max(to - from, least), high - low);
      const start = Math.min(Math.max(from, low), high - length);
      this.span = [start, start + length];
      this.draw();
    }
    key(event) {
      const step = (this.span[1] - this.span[0]) / 5;
      const act = {
        ArrowLeft: () => this.look(this.span[0] - step, this.span[1] - step),
        ArrowRight: () => this.look(this.span[0] + step, this.span[1] + step),
        "+": () => this.zoom(0.5), "-": () => this.zoom(2), 0: () => this.zoom(0),
      }[event.key];
      if (act) { event.preventDefault(); act(); }
    }
    x(t) { return LEFT + (t - this.span[0]) / (this.span[1] - this.span[0]) * (this.width - LEFT - RIGHT); }
    time(event) {
      const at = event.clientX - this.svg.getBoundingClientRect().left;
      const share = (at - LEFT) / (this.width - LEFT - RIGHT);
      return this.span[0] + Math.min(Math.max(share, 0), 1) * (this.span[1] - this.span[0]);
    }
    press(event) {
      if (event.pointerType === "touch") return this.point(this.time(event)); // a finger scrolls the page
      this.from = this.time(event);
      this.svg.setPointerCapture(event.pointerId);
    }
    move(event) {
      const t = this.time(event);
      this.point(t);
      if (this.from == null) return;
      const ends = [this.x(this.from), this.x(t)];
      this.band.setAttribute("x", Math.min(...ends));
      this.band.setAttribute("width", Math.abs(ends[1] - ends[0]));
    }
    release(event) {
      const from = this.from, to = this.time(event);
      this.from = null;
      if (from != null && Math.abs(this.x(to) - this.x(from)) > 5) this.look(Math.min(from, to), Math.max(from, to));
    }
    draw() {
      this.width = this.svg.clientWidth || 320;
      const panels = this.motion.panels, time = this.motion.time_s;
      this.height = TOP + BOTTOM + GAP * (panels.length - 1) +
        panels.reduce((sum, panel) => sum + HEIGHTS[panel.is_residual ? 1 : 0], 0);
      this.svg.replaceChildren();
      this.svg.setAttribute("viewBox", `0 0 ${this.width} ${this.height}`);
      this.svg.style.height = `${this.height}px`;
      const from = Math.max(index(time, this.span[0]) - 1, 0), to = index(time, this.span[1]);
      let top = TOP;
      for (const panel of panels) {
        const height = HEIGHTS[panel.is_residual ? 1 : 0];
        this.panel(panel, top, height, from, to);
        top += height + GAP;
      }
      const [marks, digits] = ticks(...this.span);
      for (const mark of marks)
        make("text", {x: this.x(mark), y: this.height - BOTTOM + 16, class: "tick", "text-anchor": "middle"}, this.svg)
          .textContent = mark.toFixed(digits);
      make("text", {x: this.width - RIGHT, y: this.height - 3, class: "tick", "text-anchor": "end"}, this.svg)
        .textContent = "time [s]";
      this.band = make("rect", {class: "band", x: 0, width: 0, y: TOP, height: this.height - TOP - BOTTOM}, this.svg);
      this.line = make("line", {class: "pointer", y1: TOP, y2: this.height - BOTTOM, x1: -9, x2: -9}, this.svg);
    }
    panel(panel, top, height, from, to) {
      const shown = Object.entries(panel.series).filter(([name]) => !this.hidden.has(name));
      const [low, high] = range(shown.map(([, list]) => list), from, to, panel.least);
      const y = (value) => top + (high - value) / (high - low) * height;
      const [marks, digits] = ticks(low, high);
      for (const mark of marks) {
        make("line", {x1: LEFT, x2: this.width - RIGHT, y1: y(mark), y2: y(mark), class: "grid"}, this.svg);
        make("text", {x: LEFT - 6, y: y(mark) + 4, class: "tick", "text-anchor": "end"}, this.svg)
          .textContent = mark.toFixed(digits);
      }
      const clip = make("svg", {x: LEFT, y: top, width: this.width - LEFT - RIGHT, height}, this.svg);
      const beyond = shown.reduce(
        (sum, [name, list]) => sum + this.trace(list, name, from, to, (value) => y(value) - top, height, clip), 0);
      const words = beyond ? `; ${beyond} beyond, marked at the edge` : "";
      make("text", {x: LEFT, y: top - 8, class: "title"}, this.svg).textContent = panel.title + words;
    }
    // Draw a series: a line, and the area between its extremes where it oscillates faster than a screen can show.
    // Returns how many values lie outside.
    trace(list, name, from, to, y, height, clip) {
      const x = (k) => this.x(this.motion.time_s[k]) - LEFT, text = (a, b) => `${a.toFixed(1)} ${b.toFixed(1)}`;
      let line = "", pen = "M", area = "", marks = "", upper = [], lower = [], beyond = 0, marked = -9;
      const close = () => {
        if (upper.length) area += `M${[...upper, ...lower.reverse()].join("L")}Z`;
        upper = [];
        lower = [];
      };
      for (let k = from, next; k <= to; k = next) {
        if (list[k] === null) { pen = "M"; close(); next = k + 1; continue; }
        let low = Infinity, high = -Infinity, travel = 0;
        for (next = k; next <= to && list[next] !== null && x(next) < x(k) + BLOCK; next++) {
          const at = y(list[next]);
          low = Math.min(low, at);
          high = Math.max(high, at);
          if (next > k) travel += Math.abs(at - y(list[next - 1]));
          if (at >= 0 && at <= height) continue;
          beyond++;
          if (x(next) < marked + BLOCK) continue;
          marked = x(next);
          marks += at < 0 ? `M${text(marked - 4, 7)}l4-7l4 7Z` : `M${text(marked - 4, height - 7)}l4 7l4-7Z`;
        }
        if (travel > 3 * (high - low) && high - low > BLOCK / 2) {
          for (const at of [k, next - 1]) { upper.push(text(x(at), low)); lower.push(text(x(at), high)); }
          pen = "M";
          continue;
        }
        close();
        for (let n = k; n < next; n++, pen = "L") line += pen + text(x(n), y(list[n]));
      }
      close();
      make("path", {d: line, class: `trace ${name}`}, clip);
      if (area) make("path", {d: area, class: `area ${name}`}, clip);
      if (marks) make("path", {d: marks, class: `beyond ${name}`}, clip);
      return beyond;
    }
    point(t) {
      const at = t === null ? -9 : this.x(t);
      this.line.setAttribute("x1", at);
      this.line.setAttribute("x2", at);
      if (t === null) { this.readout.textContent = this.readout.dataset.hint; return; }
      const time = this.motion.time_s;
      let k = index(time, t);
      if (k > 0 && t - time[k - 1] < time[k] - t) k--;
      const words = this.motion.panels.map((panel) => Object.entries(panel.series)
        .map(([name, list]) => `${panel.is_residual ? "error " : ""}${this.names[name]} ${list[k] === null ? "-" : list[k].toFixed(panel.digits)}`)
        .join(", ") + ` ${panel.unit}`);
      this.readout.textContent = `${time[k].toFixed(3)} s; ${words.join("; ")}`;
    }
  }
  for (const box of document.querySelectorAll(".traces")) box.figure = new Figure(box);
})();
