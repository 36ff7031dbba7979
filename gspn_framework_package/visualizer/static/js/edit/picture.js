// The drawing of the editor as a picture: a self-contained SVG, and a PNG made from it.

const SVG = "http://www.w3.org/2000/svg";
const STYLES = [
  "fill",
  "fill-opacity",
  "stroke",
  "stroke-width",
  "stroke-dasharray",
  "opacity",
  "font-family",
  "font-size",
  "font-weight",
  "text-anchor",
  "dominant-baseline",
];
const MARGIN = 30; // px around the net
const LARGEST = 12_000; // px; browsers refuse larger canvases
const LEFT_OUT = ".mark-sign, .diff-ghosts, .hit, title"; // parts of the editor that are not parts of the net

/** A copy of an element with its styles as attributes; null if it is not visible. */
function copyOf(element) {
  const style = getComputedStyle(element);
  if (style.display === "none" || style.visibility === "hidden" || element.matches(LEFT_OUT))
    return null;
  const copy = element.cloneNode(false);
  for (const name of ["class", "id", "style", "tabindex", "role"]) copy.removeAttribute(name);
  for (const { name } of [...copy.attributes])
    if (/^(data|aria)-/.test(name)) copy.removeAttribute(name);
  if (element.localName !== "g")
    for (const name of STYLES) {
      const value = style.getPropertyValue(name);
      if (value && value !== "none" && value !== "normal" && value !== "auto")
        copy.setAttribute(name, value);
      else if (value === "none" && (name === "fill" || name === "stroke"))
        copy.setAttribute(name, value);
    }
  for (const child of element.childNodes) {
    const inside = child.nodeType === Node.TEXT_NODE ? child.cloneNode() : copyOf(child);
    if (inside) copy.append(inside);
  }
  return copy;
}

/** A drawing of the page as the text of an SVG file. */
export function pictureOf(svg) {
  const sheet = copyOf(svg);
  const { width, height } = svg.getBoundingClientRect();
  for (const [key, value] of Object.entries({ xmlns: SVG, width, height }))
    sheet.setAttribute(key, value);
  return new XMLSerializer().serializeToString(sheet);
}

/** Have the browser save a file. */
export function download(blob, name) {
  const address = URL.createObjectURL(blob);
  const link = document.createElement("a");
  Object.assign(link, { href: address, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** The drawing as the text of an SVG file, with its size. */
export function svgOf(canvas) {
  canvas.settle(); // all arcs under all nodes
  canvas.labels.placeAll();
  const [x0, y0, x1, y1] = canvas.bounds();
  const [x, y] = [x0 - MARGIN, y0 - MARGIN];
  const [width, height] = [x1 - x0 + 2 * MARGIN, y1 - y0 + 2 * MARGIN].map(Math.ceil);
  const sheet = document.createElementNS(SVG, "svg");
  for (const [key, value] of Object.entries({
    xmlns: SVG,
    width,
    height,
    viewBox: `${x} ${y} ${width} ${height}`,
  }))
    sheet.setAttribute(key, value);
  const paper = document.createElementNS(SVG, "rect");
  const { backgroundColor } = getComputedStyle(canvas.container);
  const clear = backgroundColor === "rgba(0, 0, 0, 0)";
  for (const [key, value] of Object.entries({
    x,
    y,
    width,
    height,
    fill: clear ? getComputedStyle(document.body).backgroundColor : backgroundColor,
  }))
    paper.setAttribute(key, value);
  sheet.append(paper);
  for (const layer of canvas.moving) {
    const copy = copyOf(layer);
    copy?.removeAttribute("transform");
    if (copy) sheet.append(copy);
  }
  return { text: new XMLSerializer().serializeToString(sheet), width, height };
}

/** The drawing as a PNG file, at twice its size on the screen if possible. */
export async function pngOf(canvas) {
  const { text, width, height } = svgOf(canvas);
  const address = URL.createObjectURL(new Blob([text], { type: "image/svg+xml" }));
  try {
    const image = new Image();
    image.src = address;
    await image.decode();
    const scale = Math.min(2, LARGEST / Math.max(width, height));
    const sheet = document.createElement("canvas");
    sheet.width = Math.round(width * scale);
    sheet.height = Math.round(height * scale);
    sheet.getContext("2d").drawImage(image, 0, 0, sheet.width, sheet.height);
    return await new Promise((resolve, reject) => {
      const done = (blob) => (blob ? resolve(blob) : reject(new Error("it is too large")));
      sheet.toBlob(done, "image/png");
    });
  } finally {
    URL.revokeObjectURL(address);
  }
}
