"use strict";
// Content of the page; each picture is decoded once, when it is first needed.

const content = JSON.parse(/** @type {HTMLElement} */ (document.getElementById("content")).textContent || "");
const [HEIGHT, WIDTH] = content.size;
/** @type {Map<string, Promise<ImageBitmap>>} */
const decoded = new Map();

/** @param {string} text */
function bytes(text) {
  const letters = atob(text);
  const values = new Uint8Array(letters.length);
  // `Uint8Array.from` would call a function for each byte, which takes twenty times as long.
  for (let k = 0; k < values.length; k++) values[k] = letters.charCodeAt(k);
  return values;
}

/** The text of an element of the page, or the data URI of its picture. @param {string} address */
function textAt(address) {
  const element = document.querySelector(address);
  return element instanceof HTMLImageElement ? element.src : element?.textContent || "";
}

/** @param {string} address */
function decode(address) {
  let bitmap = decoded.get(address);
  if (!bitmap) {
    bitmap = uriOf(address).then((uri) => {
      const [head, text] = uri.split(",");
      // Of a blob it is decoded in another thread, once.
      return createImageBitmap(new Blob([bytes(text)], { type: head.slice("data:".length).split(";")[0] }));
    });
    decoded.set(address, bitmap);
  }
  return bitmap;
}

/** What waits for the pictures of a folder, by their addresses. @type {Map<string, (uri: string) => void>} */
const awaited = new Map();

/** The data URI of a picture: in an element of the page, or what a script in the folder beside the page hands over.
 * @param {string} address @returns {Promise<string>} */
function uriOf(address) {
  if (address.startsWith("#")) return Promise.resolve(textAt(address));
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    awaited.set(address, resolve);
    script.addEventListener("load", () => script.remove());
    script.addEventListener("error", () => reject(new Error(`${address} is missing: it belongs beside this page.`)));
    script.src = address;
    document.head.append(script);
  });
}

/** Take a picture of the folder: its script calls this. @param {string} address @param {string} uri */
function keep(address, uri) {
  awaited.get(address)?.(uri);
  awaited.delete(address);
}

// Disparity and confidence of each pixel of the central view.
const depth = {
  steps: new Uint16Array(bytes(textAt(content.depth.disparity)).buffer),
  confidence: bytes(textAt(content.depth.confidence)),
};
const SURE = content.depth.least_confidence; // of 255
const AROUND = 6; // pixels

/** @param {number} pixel */
function disparityOf(pixel) {
  return content.depth.low + (depth.steps[pixel] / 65535) * (content.depth.high - content.depth.low);
}

/** Disparity of every pixel. */
function disparities() {
  const scale = (content.depth.high - content.depth.low) / 65535;
  const values = new Float32Array(WIDTH * HEIGHT);
  for (let pixel = 0; pixel < values.length; pixel++) values[pixel] = content.depth.low + scale * depth.steps[pixel];
  return values;
}

/** Index of the pixel at a point of the picture. @param {Point} at */
function pixelAt([x, y]) {
  const column = Math.min(WIDTH - 1, Math.max(0, Math.floor(x * WIDTH)));
  return Math.min(HEIGHT - 1, Math.max(0, Math.floor(y * HEIGHT))) * WIDTH + column;
}

/** Disparity at a point: that of its pixel, or of the most confident pixel around it, or unknown. @param {Point} at */
function disparityNear(at) {
  let best = pixelAt(at);
  if (depth.confidence[best] >= SURE) return { disparity: disparityOf(best), source: "pixel" };
  const [x, y] = [best % WIDTH, Math.floor(best / WIDTH)];
  for (let row = Math.max(0, y - AROUND); row <= Math.min(HEIGHT - 1, y + AROUND); row++) {
    for (let column = Math.max(0, x - AROUND); column <= Math.min(WIDTH - 1, x + AROUND); column++) {
      const pixel = row * WIDTH + column;
      if (depth.confidence[pixel] > depth.confidence[best]) best = pixel;
    }
  }
  return { disparity: disparityOf(best), source: depth.confidence[best] >= SURE ? "neighbour" : "unknown" };
}
