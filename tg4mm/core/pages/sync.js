"use strict";
// Videos of one figure run in step; buttons pause and slow them, a slider goes through the record. Without scripts they still play.
for (const figure of document.querySelectorAll("figure")) {
  const videos = [...figure.querySelectorAll("video")];
  if (!videos.length) continue;
  const [first, ...others] = videos;
  const align = () => {
    for (const video of others) {
      if (Math.abs(video.currentTime - first.currentTime) > 0.02) video.currentTime = first.currentTime;
    }
  };
  const each = (action) => videos.forEach(action);
  first.addEventListener("seeked", align);
  first.addEventListener("play", align);
  setInterval(() => { if (!first.paused) align(); }, 1000);
  const bar = figure.querySelector(".controls");
  if (!bar) continue;
  bar.hidden = false;
  const play = bar.querySelector("[data-play]");
  const show = () => { play.textContent = first.paused ? "Play" : "Pause"; };
  first.addEventListener("play", show);
  first.addEventListener("pause", show);
  play.addEventListener("click", () => {
    const start = first.paused;
    each((video) => { if (start) video.play(); else video.pause(); });
    align();
  });
  for (const button of bar.querySelectorAll("[data-speed]")) {
    button.addEventListener("click", () => {
      each((video) => { video.playbackRate = Number(button.dataset.speed); });
      bar.querySelectorAll("[data-speed]").forEach((b) => b.setAttribute("aria-pressed", String(b === button)));
      align();
    });
  }
  const seek = bar.querySelector("[data-seek]");
  if (seek) {
    const time = bar.querySelector(".time");
    const record = Number(seek.max);
    const say = (now) => { time.textContent = now.toFixed(2) + " s"; seek.setAttribute("aria-valuetext", time.textContent); };
    const follow = () => {
      if (!first.paused) { const now = first.currentTime % record; seek.value = now; say(now); }
      requestAnimationFrame(follow);
    };
    seek.addEventListener("input", () => {
      const now = Math.min(Number(seek.value), record * 0.9999);
      each((video) => { video.pause(); video.currentTime = now; });
      say(now);
    });
    follow();
  }
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) each((video) => { video.removeAttribute("autoplay"); video.pause(); });
  show();
}
for (const button of document.querySelectorAll(".copy")) {
  if (!navigator.clipboard) break;
  button.hidden = false;
  button.addEventListener("click", async () => {
    await navigator.clipboard.writeText(button.previousElementSibling.textContent);
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = "Copy"; }, 1500);
  });
}
