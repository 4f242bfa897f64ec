"use strict";
// The time shown by bodies and curves: one slider, one button, and everything that follows them.
const report = (() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const listeners = [];
  const slider = document.getElementById("time");
  const now = document.getElementById("now");
  const play = document.getElementById("play");
  const sources = data.solids ? data.solids.bodies : data.curves;
  const moments = [...new Set(sources.flatMap((source) => source.times))].sort((a, b) => a - b);
  const first = moments[0];
  const last = moments[moments.length - 1];
  const digits = Math.min(6, Math.max(2, Math.ceil(-Math.log10((last - first) / moments.length || 1)) + 1));
  let time = first;
  let running = 0;

  // index of the last of the increasing times up to t; with slack, as they have only 9 digits in the page
  function findFrame(times, t) {
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

  const formatTime = (t) => `t = ${t.toFixed(digits)} s`;

  function setTime(t) {
    time = Math.min(Math.max(t, first), last);
    slider.value = findFrame(moments, time);
    slider.setAttribute("aria-valuetext", formatTime(time));
    now.textContent = formatTime(time);
    for (const listener of listeners) listener(time);
  }

  const step = (count) => setTime(moments[Math.min(Math.max(findFrame(moments, time) + count, 0), moments.length - 1)]);

  function stop() {
    cancelAnimationFrame(running);
    running = 0;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
  }

  function start() {
    if (time >= last) setTime(first);
    const speed = Math.max(last - first, 1e-12) / Math.min(Math.max(last - first, 4), 20); // the whole motion takes 4 to 20 s
    const startInstant = performance.now();
    const startTime = time;
    play.textContent = "Pause";
    play.setAttribute("aria-pressed", "true");
    const advance = (instant) => {
      const t = startTime + (speed * (instant - startInstant)) / 1000;
      setTime(moments[findFrame(moments, Math.max(t, startTime))]);
      if (t >= last) stop();
      else running = requestAnimationFrame(advance);
    };
    running = requestAnimationFrame(advance);
  }

  slider.max = moments.length - 1;
  slider.addEventListener("input", () => {
    stop();
    setTime(moments[Number(slider.value)]);
  });
  play.addEventListener("click", () => (running ? stop() : start()));
  for (const button of document.querySelectorAll("button[data-time]")) {
    button.addEventListener("click", () => {
      stop();
      setTime(Number(button.dataset.time));
      document.getElementById("clock").parentElement.scrollIntoView();
      slider.focus({ preventScroll: true });
    });
  }
  setTime(data.start);
  const movie = document.getElementById("movie");
  const poster = document.getElementById("poster");
  if (movie && poster) movie.poster = poster.src;

  return {
    data, moments, first, last, findFrame, setTime, step, stop, formatTime,
    get time() { return time; },
    on(listener) {
      listeners.push(listener);
      listener(time);
    },
  };
})();
