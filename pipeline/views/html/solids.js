"use strict";
// The bodies: one k3d viewer each, with one common view; each shows its last frame up to the current time.
(async () => {
  const meta = report.data.solids;
  const home = document.getElementById("bodies");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const panels = [];
  let copying = false;

  function decodeBytes(id) {
    const text = atob(document.getElementById(id).textContent);
    return Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  }

  async function loadLibrary() {
    const stream = new Blob([decodeBytes("viewer")]).stream().pipeThrough(new DecompressionStream("deflate"));
    const script = document.createElement("script");
    let library = null;
    window.define = (name, needs, factory) => { library = factory(); };
    script.textContent = await new Response(stream).text();
    document.head.append(script);
    delete window.define;
    return library;
  }

  // one camera for all, fitted to the whole motion of the bodies shown: [position, target, up], as k3d expects it
  function fitCamera(width, height) {
    const shown = panels.filter((panel) => !panel.figure.hidden).map((panel) => panel.body);
    const low = [0, 1, 2].map((i) => Math.min(...shown.map((body) => body.low[i])));
    const high = [0, 1, 2].map((i) => Math.max(...shown.map((body) => body.high[i])));
    const axes = [meta.camera.right, meta.camera.up, meta.camera.toward];
    const center = [0, 1, 2].map((j) => axes.reduce((sum, axis, i) => sum + (axis[j] * (low[i] + high[i])) / 2, 0));
    const half = Math.tan((10 * Math.PI) / 180); // half the vertical angle of view of 20 degrees
    const [across, upward, deep] = [0, 1, 2].map((i) => (high[i] - low[i]) / 2);
    const far = Math.max(upward / half, across / (half * (width / height))) / 0.9 + deep;
    return [...center.map((c, j) => c + far * axes[2][j]), ...center, ...axes[1]];
  }

  class Panel {
    constructor(index) {
      this.index = index;
      this.body = meta.bodies[index];
      this.figure = document.createElement("figure");
      this.figure.className = "body";
      this.caption = document.createElement("figcaption");
      this.view = document.createElement("div");
      this.view.className = "view";
      this.view.tabIndex = 0;
      this.view.setAttribute("role", "application");
      this.view.setAttribute("aria-label", `3D view of ${this.body.label}: arrow keys rotate, plus and minus zoom, 0 resets`);
      this.figure.append(this.caption, this.view);
    }

    async open(lib) {
      home.append(this.figure);
      this.k3d = await new lib.CreateK3DAndLoadBinarySnapshot(decodeBytes(`scene-${this.index}`).buffer, this.view);
      this.paint();
      this.reset();
      this.k3d.on(this.k3d.events.CAMERA_CHANGE, (camera) => copyCamera(this, camera));
      this.view.addEventListener("keydown", (event) => this.handleKey(event));
      this.view.addEventListener("pointerdown", () => this.view.focus());
      // the wheel scrolls the page until a body is clicked
      this.view.addEventListener("wheel", (event) => {
        if (!this.view.contains(document.activeElement)) event.stopPropagation();
      }, { capture: true, passive: true });
      this.show(report.time);
    }

    paint() {
      const color = getComputedStyle(document.documentElement).getPropertyValue("--space").trim();
      this.k3d.setClearColor(parseInt(color.slice(1), 16));
      this.k3d.render();
    }

    reset() {
      this.k3d.setCamera(fitCamera(this.view.clientWidth, this.view.clientHeight));
      this.k3d.render();
    }

    show(t) {
      const index = report.findFrame(this.body.times, t);
      const shown = this.body.times[index];
      const ended = index === this.body.times.length - 1 && t > shown * (1 + 1e-9) + 1e-12;
      const frameTime = report.formatTime(shown) === report.formatTime(t) ? "" : ended ? ` (ends at ${report.formatTime(shown)})` : ` (${report.formatTime(shown)})`;
      const gap = this.body.gaps ? this.body.gaps[index] : null;
      const lost = gap === null ? "" : `, no cell data from ${report.formatTime(gap)}`;
      this.caption.textContent = this.body.label + frameTime + lost;
      if (this.k3d && index !== this.shown) this.k3d.setTime(index);
      this.shown = index;
    }

    handleKey(event) {
      const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      if (event.key in turns) this.moveCamera(...turns[event.key].map((n) => (n * Math.PI) / 18), 1);
      else if (event.key === "+" || event.key === "=") this.moveCamera(0, 0, 0.85);
      else if (event.key === "-") this.moveCamera(0, 0, 1 / 0.85);
      else if (event.key === "0") panels.forEach((panel) => panel.k3d && panel.reset());
      else return;
      event.preventDefault();
    }

    // rotate about the vertical of the first view, tilt, and scale the distance
    moveCamera(about, tilt, scale) {
      const camera = this.k3d.getWorld().controls.object;
      const target = this.k3d.getWorld().controls.target.toArray();
      const pole = meta.camera.up;
      let arm = camera.position.toArray().map((p, i) => scale * (p - target[i]));
      arm = rotate(arm, pole, about);
      const side = unit(cross(pole, arm));
      const tilted = rotate(arm, side, -tilt);
      if (Math.abs(dot(unit(tilted), pole)) < 0.98) arm = tilted;
      this.k3d.setCamera([...arm.map((a, i) => target[i] + a), ...target, ...pole]);
      this.k3d.render();
    }
  }

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((v) => v / Math.hypot(...a));

  // Rodrigues: v rotated about a unit axis
  function rotate(v, axis, angle) {
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    const [w, along] = [cross(axis, v), dot(axis, v) * (1 - c)];
    return v.map((value, i) => c * value + s * w[i] + along * axis[i]);
  }

  function copyCamera(from, camera) {
    if (copying) return;
    copying = true;
    for (const panel of panels) {
      if (panel === from || !panel.k3d || panel.figure.hidden) continue;
      panel.k3d.setCamera(camera);
      panel.k3d.render();
    }
    copying = false;
  }

  function showColorBar() {
    const bar = document.getElementById("bar");
    const strip = document.createElement("div");
    strip.style.background = `linear-gradient(to right, ${meta.colors.join(", ")})`;
    strip.className = "strip";
    const marks = document.createElement("div");
    marks.className = "marks";
    for (let i = 0; i < 5; i += 1) {
      const sign = i === 0 && meta.below ? "≤ " : i === 4 && meta.above ? "≥ " : "";
      const mark = document.createElement("span");
      mark.textContent = sign + (1 - meta.radius + (i * meta.radius) / 2).toFixed(2);
      marks.append(mark);
    }
    bar.append(strip, marks);
    if (meta.inverted) addKey(bar, "inverted", meta.invertedColor);
    if (meta.unknownColor) addKey(bar, "no data", meta.unknownColor);
  }

  function addKey(bar, text, color) {
    const key = document.createElement("p");
    key.className = "inverted";
    key.style.setProperty("--inverted", color);
    key.textContent = text;
    bar.append(key);
  }

  async function showChosen(lib) {
    for (const box of document.querySelectorAll("#chosen input")) {
      const panel = panels[Number(box.value)];
      panel.figure.hidden = !box.checked;
      if (box.checked && !panel.k3d) await panel.open(lib);
    }
    panels.forEach((panel) => panel.k3d && !panel.figure.hidden && panel.reset());
    home.style.setProperty("--columns", Math.min(4, Math.max(1, panels.filter((p) => p.k3d && !p.figure.hidden).length)));
  }

  showColorBar();
  let lib = null;
  try {
    lib = await loadLibrary();
    const boxes = [...document.querySelectorAll("#chosen input")];
    panels.push(...meta.bodies.map((_, i) => new Panel(i)));
    boxes.forEach((box, i) => {
      box.checked = i < 4;
      box.addEventListener("change", () => showChosen(lib));
    });
    await showChosen(lib);
  } catch (error) {
    const text = document.createElement("p");
    text.textContent = `The bodies cannot be drawn: this browser lacks WebGL (${error.message || error}).`;
    home.replaceChildren(text);
    return;
  }
  report.on((t) => panels.forEach((panel) => panel.figure.hidden || panel.show(t)));
  document.getElementById("reset").addEventListener("click", () => panels.forEach((p) => p.k3d && p.reset()));
  dark.addEventListener("change", () => panels.forEach((p) => p.k3d && p.paint()));
  new ResizeObserver(() => panels.forEach((p) => p.k3d && !p.figure.hidden && p.reset())).observe(home);
  home.dataset.ready = "true";
})();
