"use strict";
// What the page computes without a browser: the lens, what a point of the picture shows, where the picture lies in the
// window, and the address. Points of the picture are [x, y], shares of its width and height. Cameras and viewpoints are
// [x, y] in view steps from the middle of the grid; slopes and disparities are in pixels per view step.

/**
 * @typedef {{ slope: number, x: number, y: number, aperture: number, tiltX: number, tiltY: number, shape: string }} Lens
 * Focus, viewpoint, width of the aperture in view steps, change of the slope from edge to edge, shape of the aperture.
 * @typedef {"slope" | "x" | "y" | "aperture" | "tiltX" | "tiltY"} LensNumber
 * @typedef {{ zoom: number, x: number, y: number }} Place  Zoom, and the point of the picture in the window's middle.
 * @typedef {{ left: number, top: number, width: number, height: number }} Box  In pixels of the window.
 * @typedef {[number, number]} Point
 */

/** Shapes of the aperture: weight of a camera by its place from the middle of an aperture of a width; more may be added.
 * @type {Record<string, (x: number, y: number, width: number) => number>} */
const SHAPES = {
  square: within((x, y) => Math.max(Math.abs(x), Math.abs(y))),
  disc: within((x, y) => Math.hypot(x, y)),
  hexagon: within((x, y) => Math.max(Math.abs(x), 0.5 * Math.abs(x) + 0.866 * Math.abs(y))),
  heart: within(heartNorm),
};
const MOST_ZOOM = 8;
const PREDICTION_STEPS = 2; // of a fixed point, and the sample of a difference of 0: as in `coding.py`
const ZERO_DIFFERENCE = 128;
const HELD = 0.5; // pixels: largest blur, in the outermost view, of a plane that stands for a slope nearby

/** The shape of all places whose norm is at most half the width, with an edge one view step wide.
 * @param {(x: number, y: number) => number} norm */
function within(norm) {
  return (/** @type {number} */ x, /** @type {number} */ y, /** @type {number} */ width) => Math.min(1, Math.max(0, width / 2 + 1 - norm(x, y)));
}

/** The shape that a grid of weights shows, one for each view at the whole width; interpolated at others.
 * @param {number[][]} rows @param {number} whole */
function shapeOf(rows, whole) {
  const weight = (/** @type {number} */ row, /** @type {number} */ column) => rows[row]?.[column] ?? 0;
  return (/** @type {number} */ x, /** @type {number} */ y, /** @type {number} */ width) => {
    const scale = (whole + 1) / (width + 1); // each view stands for a cell of one view step
    const [row, column] = [scale * y + (rows.length - 1) / 2, scale * x + (rows[0].length - 1) / 2];
    const [top, left] = [Math.floor(row), Math.floor(column)];
    const [below, right] = [row - top, column - left];
    const upper = (1 - right) * weight(top, left) + right * weight(top, left + 1);
    const lower = (1 - right) * weight(top + 1, left) + right * weight(top + 1, left + 1);
    return (1 - below) * upper + below * lower;
  };
}

/** Mean of red, green and blue, in [0, 1], of each of n by n cells of a square picture, row by row.
 * @param {Uint8ClampedArray} pixels four samples a pixel @param {number} n @param {number} side of a cell, in pixels
 * @returns {number[][]} */
function cellMeans(pixels, n, side) {
  const rows = Array.from({ length: n }, () => Array(n).fill(0));
  for (let p = 0; p < pixels.length; p += 4) {
    const [row, column] = [Math.floor(p / 4 / (n * side)), (p / 4) % (n * side)].map((at) => Math.floor(at / side));
    rows[row][column] += (pixels[p] + pixels[p + 1] + pixels[p + 2]) / (765 * side * side);
  }
  return rows;
}

/** Norm whose unit ball is a heart, point down. @param {number} x @param {number} y */
function heartNorm(x, y) {
  const [across, up] = [Math.abs(x), -y];
  // Bisection: the heart (x^2 + y^2 - 1)^3 = x^2 y^3, in a box of about 2 by 2, is star-shaped about its middle.
  let [low, high] = [0, 16 * (across + Math.abs(up)) + 1e-9];
  for (let step = 0; step < 24; step++) {
    const scale = (low + high) / 2;
    const [a, b] = [(1.15 * across) / scale, (1.15 * up) / scale + 0.1];
    if ((a * a + b * b - 1) ** 3 > a * a * b ** 3) low = scale;
    else high = scale;
  }
  return high;
}

/** Turn the difference of a view from its prediction into the view, in place; as `coding.py` predicts.
 * @param {Uint8ClampedArray} view difference, then view, four samples a pixel
 * @param {{ pixels: Uint8ClampedArray, size: Point, camera: Point }} reference of width and height `size`
 * @param {Point} camera @param {{ values: Float32Array, size: Point }} disparities of the central view */
function addPrediction(view, { pixels, size: [width, height], camera: from }, camera, { values, size: [across, down] }) {
  const [shiftX, shiftY, backX, backY] = [camera[0] / across, camera[1] / down, from[0] / across, from[1] / down];
  const clamp = (/** @type {number} */ at, /** @type {number} */ length) => Math.min(length - 1, Math.max(0, at));
  for (let row = 0, p = 0; row < height; row++) {
    const y = (row + 0.5) / height;
    for (let column = 0; column < width; column++, p += 4) {
      const x = (column + 0.5) / width;
      let [u, v, d] = [x, y, 0];
      for (let step = 0; step <= PREDICTION_STEPS; step++) {
        d = values[clamp(Math.floor(v * down), down) * across + clamp(Math.floor(u * across), across)];
        if (step < PREDICTION_STEPS) [u, v] = [x - d * shiftX, y - d * shiftY];
      }
      // Linear interpolation of the reference.
      const [left, top] = [(u + d * backX) * width - 0.5, (v + d * backY) * height - 0.5];
      const [x0, y0] = [Math.floor(left), Math.floor(top)];
      const [fx, fy] = [left - x0, top - y0];
      const [west, east] = [4 * clamp(x0, width), 4 * clamp(x0 + 1, width)];
      const [north, south] = [4 * width * clamp(y0, height), 4 * width * clamp(y0 + 1, height)];
      for (let c = 0; c < 3; c++) {
        const above = (1 - fx) * pixels[north + west + c] + fx * pixels[north + east + c];
        const below = (1 - fx) * pixels[south + west + c] + fx * pixels[south + east + c];
        view[p + c] += (1 - fy) * above + fy * below - ZERO_DIFFERENCE;
      }
    }
  }
}

/** Largest distance of the cameras from the middle along x and y. @param {Point[]} cameras @returns {Point} */
function reachOf(cameras) {
  return [Math.max(...cameras.map(([x]) => Math.abs(x))), Math.max(...cameras.map(([, y]) => Math.abs(y)))];
}

/** Width of the aperture that fits around the viewpoint: beyond the grid there are no cameras.
 * @param {Lens} lens @param {Point} reach */
function fittingAperture(lens, reach) {
  const shares = [[reach[0], lens.x], [reach[1], lens.y]].map(([most, at]) => (most > 0 ? 1 - Math.abs(at) / most : 1));
  return Math.max(0, Math.min(lens.aperture, 2 * Math.max(...reach) * Math.min(...shares)));
}

/** Weight of each camera; of a pinhole, those of linear interpolation between the cameras around it.
 * @param {Point[]} cameras @param {Lens} lens @param {Point} reach @returns {number[]} */
function cameraWeights(cameras, lens, reach) {
  const aperture = fittingAperture(lens, reach);
  return cameras.map(([x, y]) => {
    const [dx, dy] = [x - lens.x, y - lens.y];
    if (aperture === 0) return Math.max(0, 1 - Math.abs(dx)) * Math.max(0, 1 - Math.abs(dy));
    return SHAPES[lens.shape](dx, dy, aperture);
  });
}

/** Slope of the focal plane at a point. @param {Lens} lens @param {Point} at */
function localSlope(lens, [x, y]) {
  return lens.slope + lens.tiltX * (x - 0.5) + lens.tiltY * (y - 0.5);
}

/** Focus that makes a point of the central view sharp, under any tilt. @param {Lens} lens @param {Point} at @param {number} disparity */
function focusOn(lens, at, disparity) {
  return disparity - (localSlope(lens, at) - lens.slope);
}

/**
 * The point of the central view that a point of the picture shows. From the viewpoint c, a point q of disparity d lies at
 * q + (d - s) c; of several surfaces there, the nearest one is visible.
 * @param {Lens} lens
 * @param {Point} at
 * @param {(at: Point) => number} disparityAt
 * @param {{ low: number, high: number, near: number, size: Point }} scene  Ends of the disparities, 1 if larger ones
 *   are nearer and -1 if smaller ones are, width and height of the picture in pixels.
 * @returns {Point}
 */
function visiblePoint(lens, at, disparityAt, scene) {
  if (lens.x === 0 && lens.y === 0) return at;
  const slope = localSlope(lens, at);
  const n = 128;
  const step = (scene.high - scene.low) / n;
  /** @type {Point} */
  let best = at;
  let least = Infinity;
  for (let k = 0; k <= n; k++) {
    const disparity = scene.near > 0 ? scene.high - k * step : scene.low + k * step;
    /** @type {Point} */
    const from = [
      at[0] + ((slope - disparity) * lens.x) / scene.size[0],
      at[1] + ((slope - disparity) * lens.y) / scene.size[1],
    ];
    if (Math.min(...from) < 0 || Math.max(...from) > 1) continue;
    const miss = Math.abs(disparityAt(from) - disparity);
    if (miss <= step) return from;
    if (miss < least) [least, best] = [miss, from];
  }
  return best;
}

/** A slope in everyday words, `1.35 m` or `infinity`, by the dioptres at slope 0 and their growth. @param {number} slope
 * @param {[number, number]} dioptres */
function distanceOf(slope, [atZero, growth]) {
  const inverse = atZero + growth * slope;
  return inverse > 1e-3 ? `${Number((1 / inverse).toPrecision(3))} m` : "infinity";
}

// Half or twice one of these values, or `IN_FOCUS` or `FADE` of lens.js, costs at most .2 dB in the mean of a scene.
const MEAN_REACH = 7; // pixels around a pixel whose mean disparity is taken
const ENDS_REACH = 2; // pixels around it whose least and largest disparity are taken

/** Mean, least and largest disparity around each pixel, and a 0: four numbers for each. @param {Float32Array} disparities
 * @param {Point} size */
function surroundings(disparities, [width, height]) {
  const all = new Float32Array(4 * width * height).fill(0);
  for (let pixel = 0; pixel < width * height; pixel++) all.fill(disparities[pixel], 4 * pixel, 4 * pixel + 3);
  // One axis after the other: lines of so many pixels, which lie so far apart.
  for (const [length, step, lines, apart] of [[width, 4, height, 4 * width], [height, 4 * width, width, 4]]) {
    const line = [0, 1, 2].map(() => new Float32Array(length));
    const sums = new Float64Array(length + 1);
    for (let n = 0; n < lines; n++) {
      for (let k = 0; k < length; k++) {
        for (let c = 0; c < 3; c++) line[c][k] = all[n * apart + k * step + c];
        sums[k + 1] = sums[k] + line[0][k];
      }
      for (let k = 0; k < length; k++) {
        const [first, end] = [Math.max(0, k - MEAN_REACH), Math.min(length, k + MEAN_REACH + 1)];
        let [low, high] = [line[1][k], line[2][k]];
        for (let j = Math.max(0, k - ENDS_REACH); j <= Math.min(length - 1, k + ENDS_REACH); j++) {
          low = Math.min(low, line[1][j]);
          high = Math.max(high, line[2][j]);
        }
        all.set([(sums[end] - sums[first]) / (end - first), low, high], n * apart + k * step);
      }
    }
  }
  return all;
}

/** Plane nearest to a slope. @param {number[]} slopes @param {number} slope */
function nearestPlane(slopes, slope) {
  let best = 0;
  slopes.forEach((each, plane) => {
    if (Math.abs(each - slope) < Math.abs(slopes[best] - slope)) best = plane;
  });
  return best;
}

/** Plane that shows what the lens shows, or -1: whole aperture, middle viewpoint, no tilt, and a slope so near that no
 * view is blurred by more than `HELD`. @param {number[]} slopes @param {Lens} lens @param {Lens} whole @param {Point} reach */
function heldPlane(slopes, lens, whole, reach) {
  const isWhole = lens.aperture >= whole.aperture && lens.shape === whole.shape;
  if (!isWhole || lens.x !== 0 || lens.y !== 0 || lens.tiltX !== 0 || lens.tiltY !== 0) return -1;
  const plane = nearestPlane(slopes, lens.slope);
  return Math.abs(slopes[plane] - lens.slope) * Math.max(...reach) <= HELD ? plane : -1;
}

/** Where the whole picture lies in the window, of which it fills one direction at zoom 1.
 * @param {Place} place @param {Point} window @param {[number, number, number, number]} crop  Left, top, right, bottom: what is shown.
 * @param {Point} size  Width and height of the picture in pixels. @returns {Box} */
function boxOf(place, window, crop, size) {
  const shown = [(crop[2] - crop[0]) * size[0], (crop[3] - crop[1]) * size[1]];
  const scale = place.zoom * Math.min(window[0] / shown[0], window[1] / shown[1]);
  const [width, height] = [scale * size[0], scale * size[1]];
  return { left: window[0] / 2 - place.x * width, top: window[1] / 2 - place.y * height, width, height };
}

/** Point of the picture under a point of the window. @param {Box} box @param {number} x @param {number} y @returns {Point} */
function pointUnder(box, x, y) {
  return [(x - box.left) / box.width, (y - box.top) / box.height];
}

/** Zoom by a factor such that a point of the window keeps what it shows.
 * @param {Place} place @param {number} factor @param {Point} fixed  Point of the picture that stays where it is.
 * @param {[number, number, number, number]} crop @returns {Place} */
function zoomed(place, factor, fixed, crop) {
  const zoom = Math.min(MOST_ZOOM, Math.max(1, place.zoom * factor));
  const by = place.zoom / zoom;
  return inside({ zoom, x: fixed[0] + (place.x - fixed[0]) * by, y: fixed[1] + (place.y - fixed[1]) * by }, crop);
}

/** The place, with the picture's edges kept out of the window's inner part. @param {Place} place
 * @param {[number, number, number, number]} crop @returns {Place} */
function inside(place, crop) {
  const keep = (/** @type {number} */ at, /** @type {number} */ low, /** @type {number} */ high) => {
    const room = ((high - low) / 2) * (1 - 1 / place.zoom);
    return Math.min((low + high) / 2 + room, Math.max((low + high) / 2 - room, at));
  };
  return { zoom: place.zoom, x: keep(place.x, crop[0], crop[2]), y: keep(place.y, crop[1], crop[3]) };
}

/** Word of the address -> number of the lens. @type {Record<string, LensNumber>} */
const FIELDS = { f: "slope", x: "x", y: "y", a: "aperture", tx: "tiltX", ty: "tiltY" };

/** Text of the address for what differs from the start, such as `f=-0.71&x=.2&a=4`. @param {Lens} lens @param {Place} place
 * @param {Lens} whole */
function addressOf(lens, place, whole) {
  const words = [];
  const short = (/** @type {number} */ value) => String(Number(value.toFixed(3))).replace(/^(-?)0\./, "$1.");
  for (const [name, key] of Object.entries(FIELDS)) {
    if (name === "f" || Math.abs(lens[key] - whole[key]) > 5e-4) words.push(`${name}=${short(lens[key])}`);
  }
  if (lens.shape !== whole.shape) words.push(`shape=${lens.shape}`);
  if (place.zoom > 1) words.push(`z=${short(place.zoom)}`, `at=${short(place.x)},${short(place.y)}`);
  return words.join("&");
}

/** Lens and place that an address names; what it does not name, or names wrongly, is as in `whole` and `start`.
 * @param {string} text @param {Lens} whole @param {Place} start @param {{ low: number, high: number, reach: Point }} limits
 * @returns {{ lens: Lens, place: Place, names: string[] }} */
function stateOf(text, whole, start, limits) {
  const words = new URLSearchParams(text);
  const number = (/** @type {string} */ name, /** @type {number} */ least, /** @type {number} */ most, /** @type {number} */ other) => {
    const value = words.has(name) && words.get(name) !== "" ? Number(words.get(name)) : NaN;
    return Number.isFinite(value) ? Math.min(most, Math.max(least, value)) : other;
  };
  const { low, high, reach } = limits;
  const range = Math.max(high - low, 1e-6);
  const shape = words.get("shape") || "";
  const lens = {
    slope: number("f", low - range, high + range, whole.slope),
    x: number("x", -reach[0], reach[0], whole.x),
    y: number("y", -reach[1], reach[1], whole.y),
    aperture: number("a", 0, whole.aperture, whole.aperture),
    tiltX: number("tx", -4 * range, 4 * range, 0),
    tiltY: number("ty", -4 * range, 4 * range, 0),
    shape: Object.hasOwn(SHAPES, shape) ? shape : whole.shape,
  };
  const at = (words.get("at") || "").split(",").map(Number);
  const zoom = number("z", 1, MOST_ZOOM, start.zoom);
  const isAt = zoom > 1 && at.length === 2 && at.every(Number.isFinite);
  const place = isAt ? { zoom, x: at[0], y: at[1] } : { ...start, zoom };
  return { lens, place, names: [...words.keys()] };
}
