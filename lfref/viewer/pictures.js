"use strict";
// What the page holds, and its pictures, each decoded once, when it is first needed.

const held = JSON.parse(document.getElementById("held").textContent);
const [HEIGHT, WIDTH] = held.size;
const decoded = new Map();

function decode(uri) {
  if (!decoded.has(uri)) {
    const image = new Image();
    image.src = uri;
    // A bitmap stays decoded; of an image the browser may throw that away again.
    decoded.set(uri, image.decode().then(() => createImageBitmap(image)));
  }
  return decoded.get(uri);
}

function bytes(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

// How far away each pixel is, and how sure that is.
const depth = {
  steps: new Uint16Array(bytes(held.depth.disparity).buffer),
  sure: bytes(held.depth.confidence),
};
const SURE = held.depth.sure; // of 255
const AROUND = 6; // pixels

function slopeOf(pixel) {
  return held.depth.low + (depth.steps[pixel] / 65535) * (held.depth.high - held.depth.low);
}

// The slope of a point, in pixels of the picture; of the surest pixel around where the point itself tells nothing.
function slopeAt(x, y) {
  let best = y * WIDTH + x;
  if (depth.sure[best] >= SURE) return { slope: slopeOf(best), is: "known" };
  for (let row = Math.max(0, y - AROUND); row <= Math.min(HEIGHT - 1, y + AROUND); row++) {
    for (let column = Math.max(0, x - AROUND); column <= Math.min(WIDTH - 1, x + AROUND); column++) {
      const pixel = row * WIDTH + column;
      if (depth.sure[pixel] > depth.sure[best]) best = pixel;
    }
  }
  return { slope: slopeOf(best), is: depth.sure[best] >= SURE ? "around" : "unknown" };
}

function nearestPlane(slope) {
  let best = 0;
  held.slopes.forEach((each, plane) => {
    if (Math.abs(each - slope) < Math.abs(held.slopes[best] - slope)) best = plane;
  });
  return best;
}
