// Saving what is shown: tables as CSV, pictures as PNG.

/** Hand a blob, or the data address of a picture, to the reader as a file. */
function save(name, what) {
  const href = typeof what === "string" ? what : URL.createObjectURL(what);
  const link = make("a", { href, download: name.replaceAll(/[^\w.+-]+/g, "_") });
  link.click();
  if (href !== what) setTimeout(() => URL.revokeObjectURL(href), 1000);
}

/** Rows as CSV with the columns of the file, cells as they stand there. */
function csvOf(rows) {
  const names = Object.keys(rows[0] ?? {});
  const quoted = (cell) => (/[",\n]/.test(cell) ? `"${cell.replaceAll('"', '""')}"` : cell);
  return [names, ...rows.map((row) => names.map((name) => row[name]))]
    .map((cells) => `${cells.map(quoted).join(",")}\n`).join("");
}

/** One picture of canvases side by side under a title. */
function savePicture(name, title, canvases) {
  const ratio = window.devicePixelRatio || 1;
  const [gap, above] = [12 * ratio, 34 * ratio];
  const sheet = make("canvas", {
    width: canvases.reduce((sum, { width }) => sum + width + gap, gap),
    height: above + gap + Math.max(...canvases.map(({ height }) => height)),
  });
  const pen = sheet.getContext("2d");
  pen.fillStyle = colour("paper");
  pen.fillRect(0, 0, sheet.width, sheet.height);
  pen.fillStyle = colour("ink");
  pen.font = `600 ${14 * ratio}px system-ui, sans-serif`;
  pen.fillText(title, gap, 22 * ratio, sheet.width - 2 * gap);
  let left = gap;
  for (const canvas of canvases) {
    pen.drawImage(canvas, left, above);
    left += canvas.width + gap;
  }
  sheet.toBlob((blob) => save(name, blob), "image/png");
}

for (const button of document.querySelectorAll("button.save"))
  button.addEventListener("click", () =>
    save(button.dataset.name, button.closest("figure").querySelector("img").src));
