/*
 * Depth points on a plain 2-D canvas: drawn in software, so that the page looks the same with and
 * without a graphics processor. Parallel projection, so that lengths can be compared.
 *
 * Points are [x, y, z] in millimetres, antenna frame. The view has X to the right, Y up and Z
 * towards the eye; unrotated it is the radar's view: X = -x, Y = y, Z = -z.
 */
(() => {
  const { data, bytesOf, roundStep, MAX_PIXEL_RATIO } = report;
  const canvas = document.getElementById("view");
  const context = canvas.getContext("2d");
  const layer = document.createElement("canvas"); // the points, without axes
  const layerContext = layer.getContext("2d");

  const MARGIN_PX = 52; // around the box, for the labels
  const SPLAT = 1.5; // points a little larger than a pixel of the image close gaps on slopes
  const FAINTEST = 0.4; // how much colour the weakest points keep
  const SHADOW_PER_MM = 0.05; // darkening behind an edge, by the height of the edge
  const HIGHEST_EDGE_MM = 5; // higher ones cast no darker shadow
  const VIEWS = { start: [-0.5, 0.3], front: [0, 0], side: [-Math.PI / 2, 0], top: [0, Math.PI / 2] };
  const EMPTY = Math.fround(-1e30); // as a Float32Array keeps it
  const PICKED_PX = 8; // how near to a point a click chooses it
  const CLICK_PX = 4; // a press that moves farther is a drag

  const clouds = data.clouds.map((cloud) => ({
    points: new Float32Array(bytesOf(cloud.points_mm).buffer),
    level: bytesOf(cloud.level),
    colour: [1, 3, 5].map((i) => parseInt(cloud.colour.slice(i, i + 2), 16)),
    shown: false,
    boxed: false,
  }));
  const depthColours = bytesOf(data.depth_colours);

  /* The box around all clouds that have been shown: hiding one again moves nothing. */
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  let ticks = [];
  let centre = [];

  function growBox(points) {
    for (let i = 0; i < points.length; i++) {
      low[i % 3] = Math.min(low[i % 3], points[i]);
      high[i % 3] = Math.max(high[i % 3], points[i]);
    }
    const longest = Math.max(...[0, 1, 2].map((a) => high[a] - low[a]), 1);
    ticks = [0, 1, 2].map((a) => {
      // A short axis gets fewer ticks than a long one, but two at least.
      const span = Math.max(high[a] - low[a], 1);
      const step = roundStep(span / (span > 0.4 * longest ? 4 : 2.5));
      low[a] = Math.floor(low[a] / step + 1e-6) * step;
      high[a] = Math.max(Math.ceil(high[a] / step - 1e-6) * step, low[a] + step);
      const count = Math.round((high[a] - low[a]) / step);
      return Array.from({ length: count + 1 }, (_, i) => low[a] + i * step);
    });
    centre = [0, 1, 2].map((a) => (low[a] + high[a]) / 2);
  }

  let [yaw, pitch] = VIEWS.start;
  let zoom = 1;
  let shift = [0, 0]; // CSS pixels
  let byDepth = false;
  let waiting = false;

  function redraw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      draw();
    });
  }

  /* Rows X, Y, Z of the view in terms of x, y, z. */
  function axesOfView() {
    const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
    return [
      [-cy, 0, -sy],
      [-sp * sy, cp, sp * cy],
      [cp * sy, sp, -cp * cy],
    ];
  }

  /* CSS pixels per millimetre at zoom 1: the box of the present view fills the canvas. */
  function fittingScale(rows, width, height) {
    const extent = [0, 1].map((r) =>
      [0, 1, 2].reduce((sum, a) => sum + Math.abs(rows[r][a]) * (high[a] - low[a]), 0));
    return Math.max(0.01, Math.min(
      (width - 2 * MARGIN_PX) / extent[0], (height - 2 * MARGIN_PX) / extent[1]));
  }
  let fitted = null; // kept while rotating, so that a rotation does not zoom

  function draw() {
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    if (width === 0 || height === 0 || centre.length === 0) return;
    const ratio = Math.min(window.devicePixelRatio || 1, MAX_PIXEL_RATIO);
    const theme = report.theme();
    const w = Math.round(width * ratio);
    const h = Math.round(height * ratio);
    if (canvas.width !== w || canvas.height !== h) {
      canvas.width = layer.width = w;
      canvas.height = layer.height = h;
      fitted = null;
    }
    const rows = axesOfView();
    if (fitted === null) fitted = fittingScale(rows, width, height);
    const scale = fitted * zoom * ratio;
    const middle = [w / 2 + shift[0] * ratio, h / 2 + shift[1] * ratio];
    const place = (p) => {
      const d = [p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]];
      return [
        middle[0] + scale * (rows[0][0] * d[0] + rows[0][1] * d[1] + rows[0][2] * d[2]),
        middle[1] - scale * (rows[1][0] * d[0] + rows[1][1] * d[1] + rows[1][2] * d[2]),
      ];
    };
    context.fillStyle = `rgb(${theme.paper.join(" ")})`;
    context.fillRect(0, 0, w, h);
    drawBox(rows, place, theme, ratio);
    drawPoints(rows, scale, middle, theme, ratio);
    context.drawImage(layer, 0, 0);
    if (report.place() !== null) drawMark(place(report.place()), ratio);
  }

  /* A ring around the place that was chosen, visible on every colour. */
  function drawMark([x, y], ratio) {
    for (const [colour, width] of [["#ffffff", 4], ["#000000", 1.5]]) {
      context.strokeStyle = colour;
      context.lineWidth = width * ratio;
      context.beginPath();
      context.arc(x, y, 7 * ratio, 0, 2 * Math.PI);
      context.stroke();
    }
  }

  /* The foremost of the shown points near (x, y), CSS pixels from the middle; null: none. */
  function pointNear(x, y) {
    const rows = axesOfView();
    const scale = fitted * zoom;
    const reach = Math.max(PICKED_PX, scale * data.pixel_mm);
    let [found, foremost] = [null, -Infinity];
    for (const cloud of clouds.filter((one) => one.shown)) {
      for (let i = 0; i < cloud.points.length; i += 3) {
        const d = [0, 1, 2].map((a) => cloud.points[i + a] - centre[a]);
        const [right, up, towards] = rows.map((r) => r[0] * d[0] + r[1] * d[1] + r[2] * d[2]);
        const away = Math.hypot(shift[0] + scale * right - x, shift[1] - scale * up - y);
        if (away <= reach && towards > foremost) {
          found = [...cloud.points.subarray(i, i + 3)];
          foremost = towards;
        }
      }
    }
    return found;
  }

  function coloursOf(cloud, theme) {
    // One 32-bit word per level, as a canvas keeps its pixels: little-endian R, G, B, A.
    const words = new Uint32Array(256);
    const bytes = new Uint8Array(words.buffer);
    for (let i = 0; i < 256; i++) {
      const share = FAINTEST + ((1 - FAINTEST) * i) / 255;
      for (let c = 0; c < 3; c++) {
        bytes[4 * i + c] = byDepth
          ? depthColours[3 * i + c]
          : share * cloud.colour[c] + (1 - share) * theme.paper[c];
      }
      bytes[4 * i + 3] = 255;
    }
    return words;
  }

  function drawPoints(rows, scale, middle, theme, ratio) {
    const { width: w, height: h } = layer;
    const image = layerContext.createImageData(w, h);
    const pixels = new Uint32Array(image.data.buffer);
    const nearest = new Float32Array(w * h).fill(EMPTY);
    const size = Math.max(1, Math.min(40, Math.round(scale * data.pixel_mm * SPLAT)));
    const [depthLow, depthHigh] = data.depth_mm;
    for (const cloud of clouds) {
      if (!cloud.shown) continue;
      const colours = coloursOf(cloud, theme);
      const { points, level } = cloud;
      for (let i = 0; i < level.length; i++) {
        const x = points[3 * i] - centre[0];
        const y = points[3 * i + 1] - centre[1];
        const z = points[3 * i + 2] - centre[2];
        const towards = rows[2][0] * x + rows[2][1] * y + rows[2][2] * z;
        const left = Math.round(
          middle[0] + scale * (rows[0][0] * x + rows[0][1] * y + rows[0][2] * z) - size / 2);
        const top = Math.round(
          middle[1] - scale * (rows[1][0] * x + rows[1][1] * y + rows[1][2] * z) - size / 2);
        let entry = level[i];
        if (byDepth) {
          const share = (points[3 * i + 2] - depthLow) / (depthHigh - depthLow);
          entry = Math.max(0, Math.min(255, Math.round(255 * share)));
        }
        const right = Math.min(w, left + size);
        const bottom = Math.min(h, top + size);
        for (let row = Math.max(0, top); row < bottom; row++) {
          for (let at = row * w + Math.max(0, left); at < row * w + right; at++) {
            if (towards > nearest[at]) {
              nearest[at] = towards;
              pixels[at] = colours[entry];
            }
          }
        }
      }
    }
    shade(image.data, nearest, w, h, Math.max(1, Math.round(1.5 * ratio)));
    layerContext.putImageData(image, 0, 0);
  }

  /* Points behind an edge are darker: without light or normals that shows the relief. */
  function shade(bytes, nearest, w, h, reach) {
    const around = [-reach, reach, -reach * w, reach * w];
    for (let row = reach; row < h - reach; row++) {
      for (let at = row * w + reach; at < (row + 1) * w - reach; at++) {
        const here = nearest[at];
        if (here === EMPTY) continue;
        let before = 0;
        for (const step of around) {
          const there = nearest[at + step];
          if (there > here) before += Math.min(there - here, HIGHEST_EDGE_MM);
        }
        if (before === 0) continue;
        const light = Math.exp(-SHADOW_PER_MM * before);
        bytes[4 * at] *= light;
        bytes[4 * at + 1] *= light;
        bytes[4 * at + 2] *= light;
      }
    }
  }

  /* The three walls of the box behind the points, with lines at the ticks, and the labels. */
  function drawBox(rows, place, theme, ratio) {
    const behind = [0, 1, 2].map((a) => (rows[2][a] > 0 ? low[a] : high[a]));
    const ahead = [0, 1, 2].map((a) => low[a] + high[a] - behind[a]);
    const visible = [0, 1, 2].map((a) => Math.abs(rows[2][a]) > 0.02); // walls that are not edge-on
    context.strokeStyle = theme.grid;
    context.lineWidth = ratio;
    context.beginPath();
    for (let wall = 0; wall < 3; wall++) {
      if (!visible[wall]) continue;
      for (const [along, across] of [[(wall + 1) % 3, (wall + 2) % 3], [(wall + 2) % 3, (wall + 1) % 3]]) {
        for (const tick of ticks[across]) {
          const p = [];
          p[wall] = behind[wall];
          p[across] = tick;
          p[along] = low[along];
          context.moveTo(...place(p));
          p[along] = high[along];
          context.lineTo(...place(p));
        }
      }
    }
    context.stroke();
    context.fillStyle = theme.ink;
    context.textAlign = "center";
    context.textBaseline = "middle";
    const edges = [0, 1, 2].map((a) => labelledEdge(a, behind, ahead, place, ratio));
    const taken = [];
    const write = (text, p) => {
      // A label that would overlap an earlier one is omitted; names come before numbers.
      const half = [context.measureText(text).width / 2 + 3 * ratio, 8 * ratio];
      if (taken.some((t) => [0, 1].every((i) => Math.abs(t.p[i] - p[i]) < t.half[i] + half[i]))) return;
      taken.push({ p, half });
      context.fillText(text, ...p);
    };
    context.font = `600 ${12 * ratio}px system-ui, sans-serif`;
    edges.forEach((edge, a) => {
      if (edge !== null) write(`${"xyz"[a]} (mm)`, edge.name);
    });
    context.font = `${11 * ratio}px system-ui, sans-serif`;
    edges.forEach((edge, a) => {
      if (edge === null) return;
      for (const tick of ticks[a]) {
        write(String(Math.round(tick * 1000) / 1000).replace("-", "\u2212"), edge.label(tick));
      }
    });
  }

  /* Where the name of an axis goes and the labels of its ticks; null for one that is end-on. */
  function labelledEdge(a, behind, ahead, place, ratio) {
    const [b, c] = [(a + 1) % 3, (a + 2) % 3];
    // Its two edges on the outline of the box touch one wall behind and one ahead. The lower one
    // is labelled; of an upright axis the left one.
    const edges = [[behind[b], ahead[c]], [ahead[b], behind[c]]].map(([atB, atC]) => {
      const end = (value) => {
        const p = [];
        p[a] = value;
        p[b] = atB;
        p[c] = atC;
        return place(p);
      };
      const [from, to] = [end(low[a]), end(high[a])];
      return { end, from, to, middle: [(from[0] + to[0]) / 2, (from[1] + to[1]) / 2] };
    });
    const { from, to } = edges[0];
    const long = Math.hypot(to[0] - from[0], to[1] - from[1]);
    if (long < 24 * ratio) return null;
    const upright = Math.abs(to[1] - from[1]) > 2 * Math.abs(to[0] - from[0]);
    edges.sort(upright ? (p, q) => p.middle[0] - q.middle[0] : (p, q) => q.middle[1] - p.middle[1]);
    const edge = edges[0];
    // Away from the box at right angles to the edge.
    const heart = place(centre);
    let away = [(to[1] - from[1]) / long, -(to[0] - from[0]) / long];
    const out = away[0] * (edge.middle[0] - heart[0]) + away[1] * (edge.middle[1] - heart[1]);
    if (out < 0) away = [-away[0], -away[1]];
    const beside = (p, distance) => [
      p[0] + away[0] * distance * ratio, p[1] + away[1] * distance * ratio];
    // The name of an upright axis stands above its upper end, where there is space on a phone.
    const upper = edge.from[1] < edge.to[1] ? edge.from : edge.to;
    return {
      name: upright ? [upper[0], upper[1] - 18 * ratio] : beside(edge.middle, 34),
      label: (tick) => beside(edge.end(tick), upright ? 18 : 15),
    };
  }

  /* Mouse, touch and keys. */
  function turn(right, down) {
    yaw += right;
    pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, pitch + down));
    redraw();
  }

  function move(right, down) {
    shift = [shift[0] + right, shift[1] + down];
    redraw();
  }

  /* Zoom about the point (x, y), CSS pixels from the middle of the canvas. */
  function zoomBy(factor, x = 0, y = 0) {
    const before = zoom;
    zoom = Math.max(0.2, Math.min(40, zoom * factor));
    const grown = zoom / before;
    shift = [x + (shift[0] - x) * grown, y + (shift[1] - y) * grown];
    redraw();
  }

  function look(name) {
    [yaw, pitch] = VIEWS[name];
    zoom = 1;
    shift = [0, 0];
    fitted = null;
    redraw();
  }

  function fromMiddle(event) {
    const frame = canvas.getBoundingClientRect();
    return [event.clientX - frame.left - frame.width / 2, event.clientY - frame.top - frame.height / 2];
  }

  const held = new Map(); // pointer -> its last place
  let moved = 0; // pixels since the press
  canvas.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse" && event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    moved = held.size === 0 ? 0 : Infinity; // two fingers are no click
    held.set(event.pointerId, fromMiddle(event));
    canvas.classList.add("held");
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = held.get(event.pointerId);
    if (last === undefined) return;
    const now = fromMiddle(event);
    const [right, down] = [now[0] - last[0], now[1] - last[1]];
    moved += Math.hypot(right, down);
    if (held.size === 1) {
      if (event.shiftKey) move(right, down);
      else turn(right * 0.008, down * 0.008);
    } else if (held.size === 2) {
      const other = [...held].find(([pointer]) => pointer !== event.pointerId)[1];
      const distance = (p) => Math.max(1, Math.hypot(p[0] - other[0], p[1] - other[1]));
      move(right / 2, down / 2);
      zoomBy(distance(now) / distance(last), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    }
    held.set(event.pointerId, now);
  });
  canvas.addEventListener("click", (event) => {
    const point = moved < CLICK_PX ? pointNear(...fromMiddle(event)) : null;
    if (point !== null) report.choose(point);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => {
      held.delete(event.pointerId);
      canvas.classList.toggle("held", held.size > 0);
    });
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    const amount = Math.max(-120, Math.min(120, event.deltaY * lines));
    zoomBy(Math.exp(-0.0018 * amount), ...fromMiddle(event));
  }, { passive: false });

  const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = ARROWS[event.key];
    if (arrow && event.shiftKey) move(20 * arrow[0], 20 * arrow[1]);
    else if (arrow) turn(0.09 * arrow[0], 0.09 * arrow[1]);
    else if (event.key === "+" || event.key === "=") zoomBy(1.25);
    else if (event.key === "-") zoomBy(0.8);
    else if (event.key === "0" || event.key === "Home") look("start");
    else return;
    event.preventDefault();
  });

  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => look(button.dataset.view));
  }
  for (const button of document.querySelectorAll("[data-zoom]")) {
    button.addEventListener("click", () => zoomBy(Number(button.dataset.zoom)));
  }
  for (const box of document.querySelectorAll("[data-cloud]")) {
    const update = () => {
      const cloud = clouds[Number(box.dataset.cloud)];
      cloud.shown = box.checked;
      if (cloud.shown && !cloud.boxed) {
        cloud.boxed = true;
        growBox(cloud.points);
        fitted = null;
      }
      redraw();
    };
    box.addEventListener("change", update);
    update(); // a browser can keep another state over a reload
  }

  const colour = document.getElementById("colour");
  const scale = document.getElementById("scale");
  document.getElementById("near").textContent = `${data.depth_mm[0]} mm`;
  document.getElementById("far").textContent = `z = ${data.depth_mm[1]} mm`;
  const stripContext = document.getElementById("scale-colours").getContext("2d");
  const strip = stripContext.createImageData(256, 1);
  for (let i = 0; i < 256; i++) {
    strip.data.set(depthColours.subarray(3 * i, 3 * i + 3), 4 * i);
    strip.data[4 * i + 3] = 255;
  }
  stripContext.putImageData(strip, 0, 0);
  const recolour = () => {
    byDepth = colour.value === "depth";
    scale.hidden = !byDepth;
    redraw();
  };
  colour.addEventListener("change", recolour);
  recolour();

  report.onRedraw(draw); // at once: paper does not wait
  report.onChoose(redraw);
  new ResizeObserver(redraw).observe(canvas);
  redraw();
})();
