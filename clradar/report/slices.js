/*
 * Slices through the place that was chosen, of all volumes side by side: x-y, to its right z-y, and
 * below it x-z. x increases to the left, as the radar sees it; z away from the radar.
 */
(() => {
  const { data } = report;
  if (!data.slices) return;
  const canvas = document.getElementById("slices");
  const AXES = ["x", "y", "z"];
  const LEFT_PX = 40; // for labels
  const BELOW_PX = 34;
  const ABOVE_PX = 44;
  const GAP_PX = 6;
  const HIGHEST_PX = 560;
  const BACKGROUND = [0x26, 0x26, 0x26]; // below the dynamic range, as in the figure
  const colours = report.scaleOf(data.level_colours);
  const { low, high } = data.slices;
  const extent = AXES.map((_, a) => high[a] - low[a]);
  /* Which axes a panel has to the right and upwards, and which one it cuts. */
  const PANELS = [{ right: 0, up: 1, across: 2 }, { right: 2, up: 1, across: 0 }, { right: 0, up: 2, across: 1 }];
  let volumes = [];
  let drawn = []; // panels on the canvas, to be clicked

  const indexOf = (volume, a, mm) =>
    Math.max(0, Math.min(volume.counts[a] - 1, Math.round((mm - volume.origin[a]) / volume.step[a])));
  const codeAt = (volume, i) =>
    volume.codes[(i[2] * volume.counts[1] + i[1]) * volume.counts[0] + i[0]];
  const levelText = (code) => (code === 0
    ? `below ${report.text(-data.slices.range_db, 0)} dB`
    : `${report.text(-data.slices.range_db * (1 - (code - 1) / 254), 1)} dB`);
  const indexAt = (volume, place) => AXES.map((_, a) => indexOf(volume, a, place[a]));

  function draw() {
    const place = report.place();
    const width = canvas.clientWidth;
    if (place === null || width === 0 || volumes.length === 0) return;
    const column = width / volumes.length;
    const scale = Math.max(0.01, Math.min(
      (column - LEFT_PX - 3 * GAP_PX) / (extent[0] + extent[2]),
      HIGHEST_PX / (extent[1] + extent[2])));
    const height = ABOVE_PX + scale * (extent[1] + extent[2]) + GAP_PX + BELOW_PX;
    const context = report.prepared(canvas, width, height);
    drawn = [];
    volumes.forEach((volume, i) => drawVolume(context, volume, i * column, column, scale, place));
  }

  function drawVolume(context, volume, left, width, scale, place) {
    context.fillStyle = report.theme().ink;
    context.textAlign = "left";
    context.textBaseline = "middle";
    context.font = "600 13px system-ui, sans-serif";
    const name = report.fitting(context, volume.label, width - LEFT_PX - GAP_PX);
    context.fillText(name, left + LEFT_PX, 12);
    context.font = "13px system-ui, sans-serif";
    context.fillText(levelText(codeAt(volume, indexAt(volume, place))), left + LEFT_PX, 31);
    const [x0, y0] = [left + LEFT_PX, ABOVE_PX];
    const [x1, y1] = [x0 + scale * extent[0] + GAP_PX, y0 + scale * extent[1] + GAP_PX];
    const corners = [[x0, y0], [x1, y0], [x0, y1]];
    PANELS.forEach((panel, i) => {
      const box = {
        left: corners[i][0], top: corners[i][1],
        width: scale * extent[panel.right], height: scale * extent[panel.up],
      };
      drawSlice(context, volume, panel, box, place);
      drawLabels(context, panel, box, i);
      drawn.push({ ...panel, ...box });
    });
  }

  function drawSlice(context, volume, panel, box, place) {
    const { right, up, across } = panel;
    context.fillStyle = `rgb(${BACKGROUND.join(" ")})`;
    context.fillRect(box.left, box.top, box.width, box.height);
    const at = [0, 0, 0];
    at[across] = indexOf(volume, across, place[across]);
    const colourAt = (column, row) => {
      at[right] = column;
      at[up] = row;
      const code = codeAt(volume, at);
      return code === 0 ? BACKGROUND : colours[code];
    };
    const [from, to] = [right, up].map((a) => [
      volume.origin[a] - volume.step[a] / 2,
      volume.origin[a] + (volume.counts[a] - 0.5) * volume.step[a],
    ]);
    const inner = {
      left: onScreen(box, panel, right === 0 ? from[1] : from[0], 0)[0],
      top: onScreen(box, panel, 0, to[1])[1],
    };
    inner.width = (box.width * (from[1] - from[0])) / extent[right];
    inner.height = (box.height * (to[1] - to[0])) / extent[up];
    context.save();
    context.beginPath();
    context.rect(box.left, box.top, box.width, box.height);
    context.clip();
    report.drawPixels(
      context, colourAt, volume.counts[right], volume.counts[up], right === 0, inner);
    const [x, y] = onScreen(box, panel, place[right], place[up]);
    context.strokeStyle = "rgb(255 255 255 / 0.75)";
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(x, box.top);
    context.lineTo(x, box.top + box.height);
    context.moveTo(box.left, y);
    context.lineTo(box.left + box.width, y);
    context.stroke();
    context.restore();
  }

  /* Where millimetres along the panel's axes are. */
  function onScreen(box, panel, right, up) {
    const share = (right - low[panel.right]) / extent[panel.right];
    return [
      box.left + box.width * (panel.right === 0 ? 1 - share : share),
      box.top + box.height * (1 - (up - low[panel.up]) / extent[panel.up]),
    ];
  }

  /* Labels to the left of the upright axes and below the lower panels. */
  function drawLabels(context, panel, box, i) {
    const label = (tick) => report.text(tick, Number.isInteger(tick) ? 0 : 1);
    context.fillStyle = report.theme().ink;
    context.font = "11px system-ui, sans-serif";
    if (i !== 1) {
      context.textAlign = "right";
      for (const tick of report.ticks(low[panel.up], high[panel.up], box.height)) {
        context.fillText(label(tick), box.left - 4, onScreen(box, panel, 0, tick)[1]);
      }
      context.save();
      context.translate(box.left - 34, box.top + box.height / 2);
      context.rotate(-Math.PI / 2);
      context.textAlign = "center";
      context.fillText(`${AXES[panel.up]} (mm)`, 0, 0);
      context.restore();
    }
    if (i !== 0) {
      context.textAlign = "center";
      const below = box.top + box.height + 9;
      for (const tick of report.ticks(low[panel.right], high[panel.right], box.width)) {
        const x = onScreen(box, panel, tick, 0)[0];
        if (x - context.measureText(label(tick)).width / 2 >= box.left) context.fillText(label(tick), x, below);
      }
      context.fillText(`${AXES[panel.right]} (mm)`, box.left + box.width / 2, below + 14);
    }
  }

  /* A click or a drag in a panel moves the two other cuts. */
  function chooseAt(event) {
    const frame = canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - frame.left, event.clientY - frame.top];
    const panel = drawn.find((p) =>
      x >= p.left && x <= p.left + p.width && y >= p.top && y <= p.top + p.height);
    if (panel === undefined) return;
    const share = (x - panel.left) / panel.width;
    const next = [...report.place()];
    next[panel.right] = low[panel.right] + extent[panel.right] * (panel.right === 0 ? 1 - share : share);
    next[panel.up] = low[panel.up] + extent[panel.up] * (1 - (y - panel.top) / panel.height);
    report.choose(next);
  }
  canvas.addEventListener("click", chooseAt);
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerType === "mouse" && event.buttons === 1) chooseAt(event);
  });

  const sliders = AXES.map((name) => document.getElementById(`place-${name}`));
  const readings = AXES.map((name) => document.getElementById(`at-${name}`));
  sliders.forEach((slider, a) => {
    // From the centre of the first voxel to that of the last, voxel by voxel.
    const step = data.slices.step[a];
    slider.min = low[a] + step / 2;
    slider.max = high[a] - step / 2;
    slider.step = step;
    slider.addEventListener("input", () => {
      const next = [...report.place()];
      next[a] = Number(slider.value);
      report.choose(next);
    });
  });
  report.onChoose((place) => {
    place.forEach((mm, a) => {
      if (Number(sliders[a].value) !== mm) sliders[a].value = mm;
      readings[a].textContent = `${report.text(mm, 1)} mm`;
    });
    draw();
  });
  report.onRedraw(draw);
  new ResizeObserver(draw).observe(canvas);

  /* Opens at the brightest voxel of the first volume. */
  function brightest(volume) {
    const at = volume.codes.indexOf(255);
    const [nx, ny] = volume.counts;
    const index = [at % nx, Math.floor(at / nx) % ny, Math.floor(at / (nx * ny))];
    return index.map((i, a) => volume.origin[a] + i * volume.step[a]);
  }
  Promise.all(data.slices.volumes.map(async (volume) => ({ ...volume, codes: await report.unpacked(volume.codes) })))
    .then((found) => {
      volumes = found;
      canvas.dataset.ready = "yes";
      report.choose(report.place() || brightest(volumes[0]));
    }, () => canvas.replaceWith("This part needs a newer browser.")); // than one of 2022
})();
