"use strict";
// Over a spectrum the pointer reads frequency and amplitude; a drag types its band into the field of that name. A click
// on a peak presses the button of the same name below the chart, a key the button that it names.
let begun = null, dragged = false;
function pointed(event, svg = event.target.closest?.("svg[data-span]")) {
  if (!svg) return null;
  const box = svg.getBoundingClientRect(), [low, high] = svg.dataset.span.split(" ").map(Number);
  const share = ((event.clientX - box.left) / box.width * WIDTH - LEFT) / (WIDTH - LEFT - RIGHT);
  const held = Math.min(Math.max(share, 0), 1);
  return {svg, x: LEFT + held * (WIDTH - LEFT - RIGHT), hz: low + held * (high - low), span: high - low};
}
function drawn(svg, name, values, text = "") {
  let group = svg.querySelector("g.cursor");
  if (!group) {
    group = document.createElementNS(svg.namespaceURI, "g");
    group.setAttribute("class", "cursor");
    svg.append(group);
  }
  const part = document.createElementNS(svg.namespaceURI, name);
  for (const [key, value] of Object.entries(values)) part.setAttribute(key, value);
  part.textContent = text;
  group.append(part);
}
addEventListener("pointerdown", (event) => { begun = pointed(event); dragged = false; }, true);
addEventListener("pointermove", (event) => {
  document.querySelectorAll(".tg4mm g.cursor").forEach((group) => group.remove());
  const now = pointed(event, begun?.svg);
  if (!now) return;
  dragged ||= begun !== null && Math.abs(now.x - begun.x) > 4;
  const [hz, sizes] = JSON.parse(now.svg.dataset.points), far = hz.map((f) => Math.abs(f - now.hz));
  const nearest = far.indexOf(Math.min(...far)), unit = now.svg.dataset.unit;
  const size = far[nearest] < 0.02 * now.span ? `: ${sizes[nearest]} ${unit}` : "";
  const words = dragged ? [begun.hz, now.hz].sort((a, b) => a - b).map((f) => f.toPrecision(4)).join(" to ") + " Hz"
    : (size ? hz[nearest] : Number(now.hz.toPrecision(4))) + " Hz" + size;
  const height = HEIGHT - TOP - BOTTOM;
  if (dragged) drawn(now.svg, "rect", {class: "band", x: Math.min(now.x, begun.x), y: TOP, width: Math.abs(now.x - begun.x), height});
  drawn(now.svg, "line", {class: "now", x1: now.x, x2: now.x, y1: TOP, y2: HEIGHT - BOTTOM});
  drawn(now.svg, "text", {x: WIDTH - RIGHT, y: TOP + 2, "text-anchor": "end"}, words);
}, true);
addEventListener("pointerup", (event) => {
  const from = begun, to = pointed(event, begun?.svg);
  begun = null;
  if (!dragged || !to) return;
  let field = [...document.querySelectorAll("label")].find((label) => label.textContent.trim() == BAND_FIELD);
  while (field && !field.querySelector("input")) field = field.parentElement;
  const input = field?.querySelector("input");
  if (!input) return;
  const text = [from.hz, to.hz].sort((a, b) => a - b).map((f) => Number(f.toPrecision(5))).join(" ");
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(input, text);
  input.dispatchEvent(new Event("input", {bubbles: true}));
}, true);
addEventListener("click", (event) => {
  const peak = event.target.dataset?.peak;
  if (peak && !dragged) press(peak);
});
addEventListener("keydown", (event) => {
  const typed = event.target.closest?.("input:not([type=checkbox]), textarea");
  if (typed || event.ctrlKey || event.metaKey || event.altKey) return;
  const key = [...document.querySelectorAll("kbd[data-press]")].find((k) => k.dataset.key === event.key.toLowerCase());
  if (key) { event.preventDefault(); event.stopImmediatePropagation(); press(...key.dataset.press.split("|")); }
}, true);
function press(...names) {
  [...document.querySelectorAll("button")].find((b) => names.includes(b.textContent.trim()))?.click();
}
