/* A click into a panel of the figure chooses the place: x and y of the pixel, and its depth. */
(() => {
  const { data } = report;
  const image = document.querySelector("#figure-section img");
  if (!data.slices || !data.panels.length) return;
  const points = data.clouds.map((cloud) => new Float32Array(report.bytesOf(cloud.points_mm).buffer));
  image.classList.add("clickable");

  /* The depth of an image at (x, y): of its nearest point within two pixels; null: none there. */
  function depthAt(cloud, x, y) {
    let [found, nearest] = [null, 2 * data.pixel_mm];
    for (let i = 0; i < cloud.length; i += 3) {
      const away = Math.hypot(cloud[i] - x, cloud[i + 1] - y);
      if (away <= nearest) [found, nearest] = [cloud[i + 2], away];
    }
    return found;
  }

  image.addEventListener("click", (event) => {
    const frame = image.getBoundingClientRect();
    const across = (event.clientX - frame.left) / frame.width;
    const up = 1 - (event.clientY - frame.top) / frame.height;
    const panel = data.panels.find(({ box }) =>
      across >= box[0] && across <= box[2] && up >= box[1] && up <= box[3]);
    const place = report.place();
    if (panel === undefined || place === null) return;
    const { box, x, y } = panel;
    const at = [
      x[0] + ((x[1] - x[0]) * (across - box[0])) / (box[2] - box[0]),
      y[0] + ((y[1] - y[0]) * (up - box[1])) / (box[3] - box[1]),
    ];
    const depth = depthAt(points[panel.image], ...at);
    report.choose([...at, depth === null ? place[2] : depth]);
  });
})();
