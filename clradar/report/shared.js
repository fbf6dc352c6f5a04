"use strict";
/*
 * What the parts of the page share: its data, colours, and the place in space that was chosen.
 * Each part is a function of its own that runs once, in the order of page.py.
 */
const report = (() => {
  const data = JSON.parse(document.getElementById("view-data").textContent);
  const LIGHT = { paper: [255, 255, 255], grid: "#d5dbe2", ink: "#3d4650" };
  const DARK = { paper: [18, 21, 26], grid: "#39424d", ink: "#b5bec9" };
  const MAX_PIXEL_RATIO = 2; // more costs time without visible difference
  const darkScreen = window.matchMedia("(prefers-color-scheme: dark)");
  let printing = false;

  const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

  /* Bytes that are packed as zlib and base64. */
  async function unpacked(text) {
    const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  /* The smallest of 1, 2, 5 times a power of ten that is not below. */
  function roundStep(wanted) {
    const decade = 10 ** Math.floor(Math.log10(wanted));
    return decade * ([1, 2, 5].find((f) => f * decade >= wanted) || 10);
  }

  /* Round numbers from low to high, about 32 pixels apart. */
  function ticks(low, high, pixels) {
    const step = roundStep(Math.max(((high - low) * 32) / Math.max(pixels, 1), 1e-9));
    const multiples = (of) => {
      const found = [];
      for (let i = Math.ceil(low / of); i * of <= high; i++) found.push(i * of);
      return found;
    };
    // One alone is no scale: half the step, as long as there is some place.
    const found = multiples(step);
    return found.length < 2 && pixels > 40 ? multiples(step / 2) : found;
  }

  const text = (value, digits) => value.toFixed(digits).replace("-", "\u2212");

  /* Give a canvas its size on the screen and return what is needed to draw on it, in CSS pixels. */
  function prepared(canvas, width, height) {
    const ratio = Math.min(window.devicePixelRatio || 1, MAX_PIXEL_RATIO);
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.height = `${height}px`;
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.fillStyle = `rgb(${theme().paper.join(" ")})`;
    context.fillRect(0, 0, width, height);
    context.imageSmoothingEnabled = false;
    return context;
  }

  /*
   * Draw colours, one byte triple for each pixel of `columns` x `rows`, the first row at the lower
   * edge; with `mirrored` the first column is at the right.
   */
  const pixels = document.createElement("canvas");
  function drawPixels(context, colourAt, columns, rows, mirrored, box) {
    pixels.width = columns;
    pixels.height = rows;
    const small = pixels.getContext("2d", { willReadFrequently: true });
    const image = small.createImageData(columns, rows);
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const colour = colourAt(column, row);
        const at = 4 * ((rows - 1 - row) * columns + (mirrored ? columns - 1 - column : column));
        image.data[at] = colour[0];
        image.data[at + 1] = colour[1];
        image.data[at + 2] = colour[2];
        image.data[at + 3] = 255;
      }
    }
    small.putImageData(image, 0, 0);
    context.drawImage(pixels, box.left, box.top, box.width, box.height);
  }

  /* The 256 colours of a scale as triples. */
  function scaleOf(packed) {
    const bytes = bytesOf(packed);
    return Array.from({ length: 256 }, (_, i) => bytes.subarray(3 * i, 3 * i + 3));
  }

  /* Shorten a text until it fits. */
  function fitting(context, words, width) {
    if (context.measureText(words).width <= width) return words;
    let kept = words.length;
    while (kept > 1 && context.measureText(`${words.slice(0, kept)}\u2026`).width > width) kept--;
    return `${words.slice(0, kept)}\u2026`;
  }

  const theme = () => (darkScreen.matches && !printing ? DARK : LIGHT);
  const redraws = [];
  const redrawAll = () => redraws.forEach((redraw) => redraw());

  let place = null; // [x, y, z] in millimetres
  const followers = [];
  function choose(next) {
    place = next;
    followers.forEach((follow) => follow(place));
  }

  /* On paper: light, and with everything unfolded. */
  const opened = [];
  window.addEventListener("beforeprint", () => {
    for (const part of document.querySelectorAll("details:not([open])")) {
      part.open = true;
      opened.push(part);
    }
    printing = true;
    redrawAll();
  });
  window.addEventListener("afterprint", () => {
    while (opened.length > 0) opened.pop().open = false;
    printing = false;
    redrawAll();
  });
  darkScreen.addEventListener("change", redrawAll);

  return {
    data, theme, bytesOf, unpacked, roundStep, ticks, text, prepared, drawPixels, scaleOf, fitting, choose,
    MAX_PIXEL_RATIO,
    place: () => place,
    onChoose: (follow) => followers.push(follow),
    onRedraw: (redraw) => redraws.push(redraw),
  };
})();
