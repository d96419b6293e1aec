"use strict";
// Content of the page; each picture is decoded once, when it is first needed.

const content = JSON.parse(document.getElementById("content").textContent);
const [HEIGHT, WIDTH] = content.size;
const decoded = new Map();

function decode(uri) {
  if (!decoded.has(uri)) {
    const image = new Image();
    image.src = uri;
    // A bitmap stays decoded; the browser may drop the pixels of an image and decode it again.
    decoded.set(uri, image.decode().then(() => createImageBitmap(image)));
  }
  return decoded.get(uri);
}

function bytes(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

// Disparity and confidence of each pixel.
const depth = {
  steps: new Uint16Array(bytes(content.depth.disparity).buffer),
  confidence: bytes(content.depth.confidence),
};
const SURE = content.depth.least_confidence; // of 255
const AROUND = 6; // pixels

function slopeOf(pixel) {
  return content.depth.low + (depth.steps[pixel] / 65535) * (content.depth.high - content.depth.low);
}

// Slope at a pixel of the picture: its own, or that of the most confident pixel around it, or unknown.
function slopeAt(x, y) {
  let best = y * WIDTH + x;
  if (depth.confidence[best] >= SURE) return { slope: slopeOf(best), source: "pixel" };
  for (let row = Math.max(0, y - AROUND); row <= Math.min(HEIGHT - 1, y + AROUND); row++) {
    for (let column = Math.max(0, x - AROUND); column <= Math.min(WIDTH - 1, x + AROUND); column++) {
      const pixel = row * WIDTH + column;
      if (depth.confidence[pixel] > depth.confidence[best]) best = pixel;
    }
  }
  return { slope: slopeOf(best), source: depth.confidence[best] >= SURE ? "neighbour" : "unknown" };
}

function nearestPlane(slope) {
  let best = 0;
  content.slopes.forEach((planeSlope, plane) => {
    if (Math.abs(planeSlope - slope) < Math.abs(content.slopes[best] - slope)) best = plane;
  });
  return best;
}
