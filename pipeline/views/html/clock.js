"use strict";
// The time that bodies and curves show: one slider, one button, and everything that listens.
const report = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const listeners = [];
  const slider = document.getElementById("time");
  const now = document.getElementById("now");
  const play = document.getElementById("play");
  const sources = data.solids ? data.solids.bodies : data.curves;
  const moments = [...new Set(sources.flatMap((one) => one.times))].sort((a, b) => a - b);
  const first = moments[0];
  const last = moments[moments.length - 1];
  const digits = Math.min(6, Math.max(2, Math.ceil(-Math.log10((last - first) / moments.length || 1)) + 1));
  let time = first;
  let running = 0;

  // index of the last of some increasing times that is not later than t
  function at(times, t) {
    const slack = 1e-7 * Math.max(last - first, 1e-12);
    let low = 0;
    let high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= t + slack) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  const said = (t) => `t = ${t.toFixed(digits)} s`;

  function set(t) {
    time = Math.min(Math.max(t, first), last);
    slider.value = at(moments, time);
    slider.setAttribute("aria-valuetext", said(time));
    now.textContent = said(time);
    for (const listener of listeners) listener(time);
  }

  const step = (count) => set(moments[Math.min(Math.max(at(moments, time) + count, 0), moments.length - 1)]);

  function stop() {
    cancelAnimationFrame(running);
    running = 0;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
  }

  function start() {
    if (time >= last) set(first);
    const film = Math.max(last - first, 1e-12) / Math.min(Math.max(last - first, 4), 20); // 4 to 20 s for the whole
    const began = performance.now();
    const from = time;
    play.textContent = "Pause";
    play.setAttribute("aria-pressed", "true");
    const tick = (instant) => {
      const t = from + (film * (instant - began)) / 1000;
      set(moments[at(moments, Math.max(t, from))]);
      if (t >= last) stop();
      else running = requestAnimationFrame(tick);
    };
    running = requestAnimationFrame(tick);
  }

  slider.max = moments.length - 1;
  slider.addEventListener("input", () => {
    stop();
    set(moments[Number(slider.value)]);
  });
  play.addEventListener("click", () => (running ? stop() : start()));
  for (const button of document.querySelectorAll("button[data-time]")) {
    button.addEventListener("click", () => {
      stop();
      set(Number(button.dataset.time));
      document.getElementById("clock").parentElement.scrollIntoView();
      slider.focus({ preventScroll: true });
    });
  }
  set(data.start);
  const movie = document.getElementById("movie");
  const poster = document.getElementById("poster");
  if (movie && poster) movie.poster = poster.src;

  return {
    data, moments, first, last, at, set, step, stop, said,
    get time() { return time; },
    on(listener) {
      listeners.push(listener);
      listener(time);
    },
  };
})();
