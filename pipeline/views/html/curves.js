"use strict";
// Curves over time as SVG: the pointer reads them, keys step through time, buttons toggle lines; all share a time axis.
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const { data } = report;
  const charts = [];
  const view = { from: report.first, to: report.last };
  const place = document.getElementById("curves");
  const frames = [...new Set(data.curves.flatMap((curve) => curve.times))].sort((a, b) => a - b);

  function createElement(tag, attributes = {}, text = "") {
    const element = tag === "svg" || SHAPES.has(tag) ? document.createElementNS(SVG, tag) : document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    if (text) element.textContent = text;
    return element;
  }
  const SHAPES = new Set(["g", "path", "line", "text", "circle", "rect", "clipPath"]);

  function chooseTicks(low, high, count) {
    const rough = (high - low) / count || 1;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough);
    const values = [];
    for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1) values.push(i * step);
    const digits = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
    return values.map((value) => [value, value.toFixed(Math.min(digits, 9))]);
  }

  function buildSpecs() {
    const sides = data.curves.map((curve, i) => ({ curve, label: data.labels[i], color: `var(--c${i % 8})` }));
    const dashes = (i) => (i < 8 ? "" : "6 3");
    const total = {
      title: "Total volume", unit: "%", level: 100,
      lines: sides.map((s, i) => ({
        name: s.label, times: s.curve.times, values: s.curve.total, color: s.color, dash: dashes(i),
      })),
    };
    const cells = sides.map((s) => ({
      title: `Volume ratio of cells: ${s.label}`, unit: "", group: "cells", level: 1,
      bands: s.curve.bands.map(([low, high], k) => ({
        name: ["extremes", "5 to 95 %", "25 to 75 %"][k], times: s.curve.times, low, high, color: s.color,
        opacity: [0.16, 0.24, 0.36][k],
      })),
      lines: [{ name: "median", times: s.curve.times, values: s.curve.median, color: s.color, dash: "" }],
    }));
    const looks = {
      kinetic: ["var(--c0)", ""], elastic: ["var(--c1)", "7 3"], potential: ["var(--c2)", "2 3"], total: ["var(--ink)", ""],
    };
    const energies = sides.filter((s) => Object.keys(s.curve.energies).length).map((s) => ({
      title: `Energy: ${s.label}`, unit: data.energy, group: "energy", level: 0,
      lines: Object.entries(s.curve.energies).map(([name, values]) => ({
        name, times: s.curve.times, values, color: looks[name][0], dash: looks[name][1],
      })),
    }));
    return [total, ...cells, ...energies];
  }

  function findRange(spec) {
    let low = spec.level;
    let high = spec.level;
    const include = (v) => {
      if (v === null) return;
      low = Math.min(low, v);
      high = Math.max(high, v);
    };
    for (const line of spec.lines) line.values.forEach(include);
    for (const band of spec.bands || []) {
      band.low.forEach(include);
      band.high.forEach(include);
    }
    return [low, high];
  }

  const formatNumber = (v) => (v === null ? "no value" : Math.abs(v) >= 1e5 ? v.toExponential(3) : String(Number(v.toPrecision(4))));

  class Chart {
    constructor(spec) {
      this.spec = spec;
      this.figure = createElement("figure", { class: "curve" });
      this.title = createElement("figcaption");
      this.figure.append(this.title);
      const keys = createElement("div", { class: "keys" });
      for (const part of [...(spec.bands || []), ...spec.lines]) keys.append(this.createKey(part));
      this.figure.append(keys);
      this.svg = createElement("svg", { tabindex: "0", role: "slider", "aria-label": `${spec.title}, time`, height: "230" });
      this.svg.setAttribute("aria-valuemin", report.first);
      this.svg.setAttribute("aria-valuemax", report.last);
      this.read = createElement("output", { class: "read" });
      this.figure.append(this.svg, this.read);
      this.svg.addEventListener("pointermove", (e) => readAt(this.findTime(e)));
      this.svg.addEventListener("pointerleave", () => readAt(null));
      this.svg.addEventListener("click", (e) => {
        report.stop();
        report.setTime(this.findTime(e));
      });
      this.svg.addEventListener("keydown", handleKey);
    }

    createKey(part) {
      const button = createElement("button", { type: "button", "aria-pressed": "true" });
      const swatch = createElement("span", { class: "swatch", "aria-hidden": "true" });
      swatch.style.borderTopColor = part.color;
      swatch.style.borderTopStyle = part.dash ? "dashed" : "solid";
      if (part.low) swatch.style.cssText = `border: 0; background: ${part.color}; opacity: ${2 * part.opacity}; height: 10px`;
      button.append(swatch, part.name);
      button.addEventListener("click", () => {
        part.hidden = !part.hidden;
        button.setAttribute("aria-pressed", String(!part.hidden));
        this.draw();
        this.mark(report.time);
      });
      return button;
    }

    findTime(event) {
      const box = this.svg.getBoundingClientRect();
      const share = (event.clientX - box.left - this.left) / Math.max(this.width - this.left - this.right, 1);
      const t = view.from + Math.min(Math.max(share, 0), 1) * (view.to - view.from);
      const i = report.findFrame(frames, t);
      const next = frames[Math.min(i + 1, frames.length - 1)];
      return next - t < t - frames[i] ? next : frames[i];
    }

    x(t) { return this.left + ((t - view.from) / Math.max(view.to - view.from, 1e-12)) * (this.width - this.left - this.right); }

    y(v) { return 8 + (1 - (v - this.low) / (this.high - this.low)) * (this.height - 38); }

    listPoints(times, values, reversed = false) {
      const points = times.map((t, i) => (values[i] === null ? null : `${this.x(t).toFixed(1)},${this.y(values[i]).toFixed(1)}`));
      if (reversed) points.reverse();
      return points.filter((p) => p !== null);
    }

    draw() {
      const { spec, svg } = this;
      [this.width, this.height] = [Math.max(svg.clientWidth, 200), 230];
      [this.left, this.right] = [58, 10];
      const [low, high] = spec.range;
      const room = 0.06 * (high - low) || 0.01 * Math.max(Math.abs(high), 1);
      [this.low, this.high] = [low - room, high + room];
      svg.setAttribute("viewBox", `0 0 ${this.width} ${this.height}`);
      svg.replaceChildren();
      const prefixes = spec.unit.startsWith("J") ? [[1e9, "G"], [1e6, "M"], [1e3, "k"]] : [];
      const [scale, letter] = prefixes.find(([factor]) => Math.max(-low, high) >= factor) || [1, ""];
      this.scale = scale;
      this.title.textContent = spec.unit ? `${spec.title} [${letter}${spec.unit}]` : spec.title;
      for (const [value, text] of chooseTicks(this.low / scale, this.high / scale, 5)) {
        const y = this.y(value * scale);
        svg.append(createElement("line", { x1: this.left, x2: this.width - this.right, y1: y, y2: y, class: "grid" }));
        svg.append(createElement("text", { x: this.left - 6, y: y + 4, "text-anchor": "end" }, text));
      }
      for (const [value, text] of chooseTicks(view.from, view.to, Math.max(2, this.width / 110))) {
        svg.append(createElement("text", { x: this.x(value), y: this.height - 14, "text-anchor": "middle" }, text));
      }
      svg.append(createElement("text", { x: this.width - this.right, y: this.height - 1, "text-anchor": "end" }, "time [s]"));
      this.drawParts();
    }

    drawParts() {
      const { spec, svg } = this;
      const id = `clip-${charts.indexOf(this)}`;
      const clip = createElement("clipPath", { id });
      clip.append(createElement("rect", { x: this.left, y: 0, width: Math.max(this.width - this.left - this.right, 1), height: this.height - 30 }));
      const inner = createElement("g", { "clip-path": `url(#${id})` });
      const level = this.y(spec.level);
      inner.append(createElement("line", { x1: this.left, x2: this.width, y1: level, y2: level, class: "level" }));
      for (const band of (spec.bands || []).filter((b) => !b.hidden)) {
        const edge = [...this.listPoints(band.times, band.low), ...this.listPoints(band.times, band.high, true)];
        const look = `fill: ${band.color}; fill-opacity: ${band.opacity}`;
        inner.append(createElement("path", { d: `M${edge.join("L")}Z`, style: look, class: "band" }));
      }
      for (const line of spec.lines.filter((l) => !l.hidden)) {
        const look = `stroke: ${line.color}; stroke-dasharray: ${line.dash || "none"}`;
        inner.append(createElement("path", { d: `M${this.listPoints(line.times, line.values).join("L")}`, style: look, class: "line" }));
      }
      this.cursor = createElement("g");
      inner.append(this.cursor);
      svg.append(clip, inner);
    }

    mark(t) {
      if (!this.cursor) return;
      const x = this.x(t);
      this.cursor.replaceChildren(createElement("line", { x1: x, x2: x, y1: 8, y2: this.height - 30, class: "cursor" }));
      const readings = [];
      for (const part of [...(this.spec.bands || []), ...this.spec.lines].filter((p) => !p.hidden)) {
        const i = report.findFrame(part.times, t);
        const values = part.low ? [part.low[i], part.high[i]] : [part.values[i]];
        readings.push(`${part.name} ${values.map((v) => formatNumber(v === null ? v : v / this.scale)).join(" … ")}`);
        if (part.low || values[0] === null) continue;
        this.cursor.append(createElement("circle", { cx: this.x(part.times[i]), cy: this.y(values[0]), r: 4, style: `fill: ${part.color}` }));
      }
      this.read.textContent = `${report.formatTime(t)}: ${readings.join("; ")}`;
      this.svg.setAttribute("aria-valuenow", t);
      this.svg.setAttribute("aria-valuetext", this.read.textContent);
    }
  }

  function readAt(t) {
    for (const chart of charts) chart.mark(t === null ? report.time : t);
  }

  function handleKey(event) {
    const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10, Home: -1e9, End: 1e9 };
    const zooms = { "+": 0.5, "-": 2 };
    if (event.key in steps) report.step(steps[event.key]);
    else if (event.key in zooms) zoom(zooms[event.key]);
    else return;
    report.stop();
    event.preventDefault();
  }

  // scale the range of times shown, centered on the current time
  function zoom(factor) {
    const whole = report.last - report.first;
    const span = Math.min(Math.max((view.to - view.from) * factor, whole / 1000), whole);
    showSpan(span);
  }

  function showSpan(span) {
    view.from = Math.min(Math.max(report.time - span / 2, report.first), report.last - span);
    view.to = view.from + span;
    redraw();
  }

  function redraw() {
    for (const chart of charts) {
      chart.draw();
      chart.mark(report.time);
    }
  }

  const groups = {};
  for (const spec of buildSpecs()) {
    spec.range = findRange(spec);
    if (spec.group) {
      const shared = (groups[spec.group] ||= [...spec.range]);
      [shared[0], shared[1]] = [Math.min(shared[0], spec.range[0]), Math.max(shared[1], spec.range[1])];
      spec.range = shared;
    }
    const chart = new Chart(spec);
    charts.push(chart);
    place.append(chart.figure);
  }
  document.getElementById("closer").addEventListener("click", () => zoom(0.5));
  document.getElementById("wider").addEventListener("click", () => zoom(2));
  document.getElementById("whole").addEventListener("click", () => zoom(Infinity));
  redraw();
  new ResizeObserver(redraw).observe(place);
  report.on((t) => {
    if (t < view.from || t > view.to) showSpan(view.to - view.from);
    for (const chart of charts) chart.mark(t);
  });
})();
