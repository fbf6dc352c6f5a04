/*
 * The time line: amplitude above depth of every image in the chosen frame, a chart of one metric
 * over all frames, and the frame's depth points for the 3-D view.
 */
(() => {
  const { data } = report;
  if (!data.frames) return;
  const frames = data.frames;
  const [columns, rows] = frames.counts;
  const [canvas, chart, slider, play, metric] = ["frames", "chart", "frame", "play", "metric"].map(
    (id) => document.getElementById(id));
  const LEFT_PX = 44; // for labels
  const BELOW_PX = 34;
  const ABOVE_PX = 26;
  const GAP_PX = 8;
  const LABEL_PX = 200; // of a column at least, where there is as much
  const HIGHEST_PX = 300; // of one picture
  const CHART_PX = 220;
  const PLAY_MS = 200; // per frame
  const BACKGROUNDS = [[0x26, 0x26, 0x26], [0xd9, 0xd9, 0xd9]]; // as in the figure
  const scales = [report.scaleOf(data.level_colours), report.scaleOf(data.depth_colours)];
  const low = frames.first.map((first, a) => first - frames.step[a] / 2);
  const extent = frames.counts.map((count, a) => count * frames.step[a]);
  const span = frames.depth[1] - frames.depth[0];
  const depthOf = (code) => frames.depth[0] + (span * (code - 1)) / 254;
  let images = []; // bytes of every image: frame by frame its levels, then its depths
  let at = 0;

  const partOf = (image, part) => {
    const size = columns * rows;
    return image.subarray((2 * at + part) * size, (2 * at + part + 1) * size);
  };

  /* Colours of levels, and of depths on the scale of the 3-D view. */
  function colourOf(part, code) {
    if (code === 0) return BACKGROUNDS[part];
    if (part === 0) return scales[0][code];
    const [nearest, farthest] = data.depth_mm;
    const share = (depthOf(code) - nearest) / (farthest - nearest);
    return scales[1][Math.max(0, Math.min(255, Math.round(255 * share)))];
  }

  function drawPictures() {
    const width = canvas.clientWidth;
    if (width === 0 || images.length === 0) return;
    const widest = width / images.length;
    const scale = Math.min((widest - LEFT_PX - GAP_PX) / extent[0], HIGHEST_PX / extent[1]);
    const column = Math.min(widest, Math.max(scale * extent[0] + 2 * LEFT_PX, LABEL_PX));
    const height = ABOVE_PX + 2 * scale * extent[1] + GAP_PX + BELOW_PX;
    const context = report.prepared(canvas, width, height);
    images.forEach((image, i) => {
      const left = i * column + LEFT_PX;
      context.fillStyle = report.theme().ink;
      context.textAlign = "left";
      context.textBaseline = "middle";
      context.font = "600 13px system-ui, sans-serif";
      context.fillText(report.fitting(context, frames.labels[i], column - LEFT_PX - GAP_PX), left, 12);
      for (const part of [0, 1]) {
        const codes = partOf(image, part);
        const box = {
          left, top: ABOVE_PX + part * (scale * extent[1] + GAP_PX),
          width: scale * extent[0], height: scale * extent[1],
        };
        report.drawPixels(
          context, (x, y) => colourOf(part, codes[y * columns + x]), columns, rows, true, box);
        drawTicks(context, box, part === 1);
      }
    });
  }

  function drawTicks(context, box, below) {
    const label = (tick) => report.text(Math.round(tick * 100) / 100, 0);
    context.fillStyle = report.theme().ink;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "right";
    for (const tick of report.ticks(low[1], low[1] + extent[1], box.height)) {
      context.fillText(label(tick), box.left - 4, box.top + box.height * (1 - (tick - low[1]) / extent[1]));
    }
    if (!below) return;
    context.textAlign = "center";
    for (const tick of report.ticks(low[0], low[0] + extent[0], box.width)) {
      const x = box.left + box.width * (1 - (tick - low[0]) / extent[0]);
      context.fillText(label(tick), x, box.top + box.height + 9);
    }
    context.fillText("x, y (mm)", box.left + box.width / 2, box.top + box.height + 24);
  }

  /* The depth points of the frame: x, y, z in millimetres, and levels of 0 to 255. */
  function points() {
    return images.map((image) => {
      const [level, depth] = [partOf(image, 0), partOf(image, 1)];
      const [places, levels] = [[], []];
      depth.forEach((code, i) => {
        if (code === 0 || level[i] === 0) return;
        places.push(
          frames.first[0] + (i % columns) * frames.step[0],
          frames.first[1] + Math.floor(i / columns) * frames.step[1],
          depthOf(code));
        levels.push(Math.round(((level[i] - 1) * 255) / 254));
      });
      return { points: Float32Array.from(places), level: Uint8Array.from(levels) };
    });
  }

  const shownMetric = () => frames.metrics[Number(metric.value)];
  const x = (i, width) => LEFT_PX + ((width - LEFT_PX - GAP_PX) * (i + 0.5)) / frames.names.length;

  function drawChart() {
    const width = chart.clientWidth;
    if (width === 0) return;
    const context = report.prepared(chart, width, CHART_PX);
    const { values } = shownMetric();
    const known = values.flat().filter((value) => value !== null);
    let [bottom, top] = known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
    const margin = 0.08 * (top - bottom) || 0.5;
    [bottom, top] = [bottom - margin, top + margin];
    const y = (value) => GAP_PX + (CHART_PX - GAP_PX - BELOW_PX) * (1 - (value - bottom) / (top - bottom));
    const { grid, ink } = report.theme();
    context.strokeStyle = grid;
    context.fillStyle = ink;
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.textAlign = "right";
    const marks = report.ticks(bottom, top, CHART_PX - BELOW_PX);
    const digits = Math.max(0, -Math.floor(Math.log10((marks[1] - marks[0]) * 1.001 || 1)));
    for (const tick of marks) {
      context.beginPath();
      context.moveTo(LEFT_PX, y(tick));
      context.lineTo(width - GAP_PX, y(tick));
      context.stroke();
      context.fillText(report.text(tick, digits), LEFT_PX - 4, y(tick));
    }
    context.textAlign = "center";
    const every = Math.max(1, Math.ceil((80 * frames.names.length) / width));
    frames.names.forEach((name, i) => {
      if (i % every === 0) context.fillText(report.fitting(context, name, 76), x(i, width), CHART_PX - BELOW_PX + 12);
    });
    context.strokeStyle = ink;
    context.beginPath();
    context.moveTo(x(at, width), GAP_PX);
    context.lineTo(x(at, width), CHART_PX - BELOW_PX);
    context.stroke();
    values.forEach((line, i) => drawLine(context, line, data.clouds[i + 1].colour, y, width));
  }

  /* A line with a point at every frame; a frame without a value is a gap. */
  function drawLine(context, line, colour, y, width) {
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = 2;
    context.beginPath();
    line.forEach((value, i) => {
      if (value === null) return;
      if (i > 0 && line[i - 1] !== null) context.lineTo(x(i, width), y(value));
      else context.moveTo(x(i, width), y(value));
    });
    context.stroke();
    context.lineWidth = 1;
    line.forEach((value, i) => {
      if (value === null) return;
      context.beginPath();
      context.arc(x(i, width), y(value), i === at ? 5 : 2.5, 0, 2 * Math.PI);
      context.fill();
    });
  }

  function writeValues() {
    const { values, digits } = shownMetric();
    const items = values.map((line, i) => {
      const item = document.createElement("li");
      const swatch = document.createElement("span");
      swatch.className = `swatch cloud-${i + 1}`;
      const value = line[at] === null ? "n/a" : report.text(line[at], digits);
      item.append(swatch, ` ${frames.labels[i + 1]}: ${value}`);
      return item;
    });
    document.getElementById("values").replaceChildren(...items);
  }

  function show(next) {
    at = Math.max(0, Math.min(frames.names.length - 1, next));
    slider.value = at;
    slider.setAttribute("aria-valuetext", frames.names[at]);
    document.getElementById("frame-name").textContent = frames.names[at];
    drawPictures();
    drawChart();
    writeValues();
    if (images.length > 0) report.showPoints(points());
  }

  let playing = null;
  function togglePlaying() {
    if (playing === null) playing = setInterval(() => show((at + 1) % frames.names.length), PLAY_MS);
    else playing = clearInterval(playing) || null;
    play.textContent = playing === null ? "Play" : "Pause";
  }

  slider.max = frames.names.length - 1;
  slider.addEventListener("input", () => show(Number(slider.value)));
  play.addEventListener("click", togglePlaying);
  frames.metrics.forEach((one, i) => metric.append(new Option(one.name, i)));
  metric.addEventListener("change", () => show(at));
  chart.addEventListener("click", (event) => {
    const frame = chart.getBoundingClientRect();
    const share = (event.clientX - frame.left - LEFT_PX) / (frame.width - LEFT_PX - GAP_PX);
    show(Math.floor(share * frames.names.length));
  });
  const redraw = () => {
    drawPictures();
    drawChart();
  };
  report.onRedraw(redraw);
  new ResizeObserver(redraw).observe(canvas);
  Promise.all(frames.codes.map(report.unpacked)).then((found) => {
    images = found;
    show(0);
    canvas.dataset.ready = "yes";
  }, () => report.missing(canvas));
})();
