// V(t) and alignment, drawn by uPlot; a line follows the time of the replay.

const HEIGHT = 108;

/**
 * Plot in a box; seek(time) is called where the reader clicks or drags. Returns a function that
 * moves the line to a time.
 */
function plot(box, series, data, yRange, xMax, seek) {
  box.replaceChildren();
  const axis = {
    stroke: colour("muted"),
    grid: { stroke: colour("grid"), width: 1 },
    ticks: { show: false },
    font: "11px system-ui, sans-serif",
  };
  const options = {
    width: Math.max(200, box.clientWidth),
    height: HEIGHT,
    pxAlign: 0,
    legend: { show: false },
    cursor: { show: false },
    padding: [6, 20, 0, 0],
    scales: { x: { time: false, range: [0, xMax] }, y: { range: yRange } },
    axes: [
      { ...axis, size: 26, gap: 7, values: (_, at) => at.map((x) => `${x} s`) },
      { ...axis, size: (_, texts) => 12 + 7 * longest(texts), gap: 4, space: 26,
        values: (_, at) => at.map(tick) },
    ],
    series: [{}, ...series],
  };
  const head = make("div", { className: "playhead" });
  let shown = 0;
  const move = (chart) => {
    head.style.transform = `translateX(${chart.valToPos(shown, "x")}px)`;
  };
  const chart = new uPlot({ ...options, hooks: { draw: [move] } }, data, box);
  chart.over.append(head);
  const point = (event) => {
    const left = event.clientX - chart.over.getBoundingClientRect().left;
    seek(Math.min(xMax, Math.max(0, chart.posToVal(left, "x"))));
  };
  chart.over.addEventListener("pointerdown", (event) => {
    chart.over.setPointerCapture(event.pointerId);
    point(event);
  });
  chart.over.addEventListener("pointermove", (event) => {
    if (event.buttons & 1) point(event);
  });
  return (time) => {
    shown = time;
    move(chart);
  };
}

/** Letters of the longest label, so that none is cut. */
function longest(texts) {
  return Math.max(4, ...(texts ?? []).map((text) => String(text).length));
}

/** V(t) as points, with the jump of each merge as a vertical line. */
function lyapunovPoints(rec) {
  const [times, values] = [[], []];
  const sliver = 1e-7 * (rec.times.at(-1) + 1);
  rec.times.forEach((time, frame) => {
    const [before, after] =
      [rec.lyapunov_before_merge[frame], rec.lyapunov_after_merge[frame]];
    if (!Number.isNaN(before)) {
      times.push(time - 2 * sliver, time - sliver);
      values.push(before, after);
    }
    times.push(time);
    values.push(rec.lyapunov[frame]);
  });
  return [times, values];
}

function lyapunovPlot(box, rec, other, top, xMax, seek) {
  const series = [{ stroke: colour("accent"), width: 2 }];
  let data = lyapunovPoints(rec);
  if (other) {
    data = uPlot.join([data, lyapunovPoints(other)]);
    series.push({ stroke: colour("muted"), width: 1, dash: [5, 4] });
  }
  series.forEach((line) => Object.assign(line, { points: { show: false }, spanGaps: false }));
  return plot(box, series, data, [0, 1.05 * top || 1], xMax, seek);
}

function alignmentPlot(box, rec, chosen, xMax, seek) {
  const [frames, robots] = rec.shape.alignment;
  const data = [Array.from(rec.times)];
  const series = [];
  for (let robot = 0; robot < robots; robot++) {
    const values = Array.from({ length: frames }, (_, frame) => {
      const value = rec.alignment[frame * robots + robot];
      return Number.isNaN(value) ? null : value;
    });
    const faint = chosen !== null && chosen !== robot;
    data.push(values);
    series.push({
      stroke: robotColour(robot),
      width: chosen === robot ? 2.5 : 1.3,
      alpha: faint ? 0.3 : 1,
      points: { show: false },
    });
  }
  return plot(box, series, data, [0, 1.06], xMax, seek);
}
