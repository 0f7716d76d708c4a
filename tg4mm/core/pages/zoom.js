"use strict";
// A chart that has its numbers beside it is drawn by uPlot: drag to zoom, double click for all, the cursor reads values.
// Without scripts, and in print, the drawing stays.
{
  const css = (name) => name.startsWith("--") ? getComputedStyle(document.documentElement).getPropertyValue(name).trim() : name;
  const font = "12px " + css("--sans");
  const short = (value) => value == null ? "–" : String(Number(value.toPrecision(4)));
  const axis = (label, more) => ({label, stroke: () => css("--muted"), font, labelFont: font, grid: {stroke: () => css("--rule"), width: 1}, ticks: {stroke: () => css("--rule")}, values: (u, at) => at.map((v) => v == null ? "" : short(v)), labelSize: 20, size: 32, ...more});
  const wide = (u, texts) => 20 + 7 * Math.max(3, ...(texts || []).map((text) => (text || "").length));
  const decades = (u, at) => at.map((v) => v == null || Math.abs(Math.log10(v) - Math.round(Math.log10(v))) > 1e-6 ? "" : v < 1e-3 ? v.toExponential(0) : short(v));
  const meshes = (u, chart) => {
    for (const mesh of chart.levels) {
      for (const [row, steps] of mesh.steps.entries()) {
        const top = u.valToPos(mesh.y[row + 1], "y", true), low = u.valToPos(mesh.y[row], "y", true);
        for (const [column, step] of steps.entries()) {
          const left = u.valToPos(mesh.x[column], "x", true), right = u.valToPos(mesh.x[column + 1], "x", true);
          u.ctx.fillStyle = mesh.colours[step];
          u.ctx.fillRect(left, top, right - left + 0.5, low - top + 0.5);
        }
      }
    }
  };
  const within = (u, draw) => {
    const {left, top, width, height} = u.bbox, ctx = u.ctx;
    ctx.save();
    ctx.beginPath(); ctx.rect(left, top, width, height); ctx.clip();
    draw(ctx, left, left + width);
    ctx.restore();
  };
  const over = (u, chart) => within(u, (ctx, left, right) => {
    ctx.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
    for (const [value, colour] of chart.across) {
      const y = u.valToPos(value, "y", true);
      ctx.strokeStyle = css(colour); ctx.lineWidth = devicePixelRatio;
      ctx.beginPath(); ctx.moveTo(left, y); ctx.lineTo(right, y); ctx.stroke();
    }
    ctx.fillStyle = css("--ink"); ctx.textAlign = "center"; ctx.font = 11 * devicePixelRatio + "px " + css("--sans");
    for (const [x, y, text] of chart.marks) ctx.fillText(text, u.valToPos(x, "x", true), u.valToPos(y, "y", true) - 7 * devicePixelRatio);
  });
  const level = (mesh, x, y) => {
    const cell = (edges, at) => edges.findIndex((edge, k) => k + 1 < edges.length && edge <= at && at < edges[k + 1]);
    const row = cell(mesh.y, y), column = cell(mesh.x, x), [low, high] = mesh.limits;
    return row < 0 || column < 0 ? null : low + (mesh.steps[row][column] + 0.5) / mesh.colours.length * (high - low);
  };
  // Aligned data and options: a band is two curves without a line that the third has between them.
  const parts = (chart) => {
    const log = (values) => chart.log ? values.map((v) => v > 0 ? v : null) : values;
    const data = [chart.x.length ? chart.x : chart.xRange], series = [{label: chart.xLabel, value: (u, v) => short(v)}], bands = [];
    for (const own of chart.series) {
      const width = own.points ? 0 : own.dash ? 1 : 1.4, stroke = () => css(own.colour);
      if (own.low) {
        for (const edge of [own.high, own.low]) { data.push(log(edge)); series.push({label: "", width: 0, points: {show: false}, class: "edge"}); }
        bands.push({series: [data.length - 2, data.length - 1], fill: () => css(own.colour) + "40"});
      }
      data.push(log(own.y));
      series.push({label: own.name || chart.yLabel, stroke, width, dash: own.dash ? [5, 4] : undefined, spanGaps: true, value: (u, v) => short(v),
        points: {show: !!own.points, size: 6, fill: stroke}, class: own.name || chart.series.length == 1 ? "named" : "edge",
        ...(own.stem ? {paths: uPlot.paths.bars({size: [1, 3]}), fill: stroke, class: "edge"} : {})});
    }
    return {data, series, bands};
  };
  for (const element of document.querySelectorAll("script.curves")) {
    const chart = JSON.parse(element.textContent), panel = element.parentElement, svg = panel.querySelector("svg");
    const {data, series, bands} = parts(chart), [width, height] = svg.viewBox.baseVal ? [svg.viewBox.baseVal.width, svg.viewBox.baseVal.height] : [5, 3];
    const ranges = {x: chart.xRange, y: chart.yRange};
    const size = () => ({width: box.clientWidth, height: Math.max(220, box.clientWidth * height / width)});
    const box = document.createElement("div"), bar = document.createElement("div"), read = document.createElement("output");
    box.className = "zoomed"; bar.className = "zooms"; read.className = "time";
    panel.classList.add("zooming");
    panel.append(box, bar);
    const set = (u, to) => u.batch(() => { for (const key of ["x", "y"]) u.setScale(key, {min: to[key][0], max: to[key][1]}); });
    const scale = (key, more) => ({time: false, auto: false, min: ranges[key][0], max: ranges[key][1], range: (u, low, high) => [low ?? ranges[key][0], high ?? ranges[key][1]], ...more});
    const grid = {show: !chart.levels.length}, axes = [axis(chart.xLabel, grid.show ? {} : {grid}), axis(chart.yLabel, {size: wide, ...(chart.log ? {values: decades} : {}), ...(grid.show ? {} : {grid})})], scales = {x: scale("x"), y: scale("y", {distr: chart.log ? 3 : 1})};
    if (chart.second && box.clientWidth > 420) {
      scales.second = {from: "y", auto: false, range: (u, low, high) => [low * chart.second[1], high * chart.second[1]], distr: chart.log ? 3 : 1};
      axes.push(axis(chart.second[0], {side: 1, scale: "second", size: wide, ...(chart.log ? {values: decades} : {}), grid: {show: false}}));
    }
    const plot = new uPlot({
      ...size(), series, bands, axes, scales, legend: {live: !chart.levels.length, show: !chart.levels.length},
      cursor: {drag: {x: true, y: true, uni: 24}, bind: {dblclick: (u) => () => { set(u, ranges); }}},
      hooks: {
        drawClear: [(u) => within(u, () => meshes(u, chart))],
        draw: [(u) => over(u, chart)],
        setCursor: [(u) => {
          if (!chart.levels.length) return;
          const x = u.posToVal(u.cursor.left, "x"), y = u.posToVal(u.cursor.top, "y"), found = u.cursor.left < 0 ? null : level(chart.levels[0], x, y);
          read.textContent = found == null ? "" : `${short(x)} s, ${short(y)} Hz: ${found.toFixed(0)} dB`;
        }],
      },
    }, data, box);
    for (const [text, name, factor, shift] of [["+", "Zoom in", 0.5, 0], ["−", "Zoom out", 2, 0], ["◂", "To the left", 1, -0.4], ["▸", "To the right", 1, 0.4], ["All", "Show all", 0, 0]]) {
      const button = document.createElement("button");
      button.type = "button"; button.textContent = text; button.title = name; button.setAttribute("aria-label", name);
      button.addEventListener("click", () => {
        if (!factor) { set(plot, ranges); return; }
        const {min, max} = plot.scales.x, [low, high] = ranges.x;
        const span = Math.min((max - min) * factor, high - low), middle = (min + max) / 2 + shift * (max - min);
        const from = Math.min(Math.max(middle - span / 2, low), high - span);
        plot.setScale("x", {min: from, max: from + span});
      });
      bar.append(button);
    }
    bar.append(read);
    new ResizeObserver(() => { if (box.clientWidth) plot.setSize(size()); }).observe(box);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plot.redraw());
  }
}
