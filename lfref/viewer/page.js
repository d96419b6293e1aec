"use strict";
// The page: one state, from which all is drawn, at most once a frame. Gestures, keys, sliders, the address and messages
// change the state alone. While anything moves the lens draws; at rest the best method's picture fades in, if one of
// its planes shows the same.

/** @param {string} name @returns {any} */
const find = (name) => document.getElementById(name);
const [stage, flatCanvas] = [find("stage"), find("flat")];
let liveCanvas = find("live");
const flat = /** @type {CanvasRenderingContext2D} */ (flatCanvas.getContext("2d"));
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const TO_FOCUS = 250; // milliseconds until a point that was tapped is in focus
const REST = 180; // milliseconds without a change after which the picture rests
const INTRO = 2000; // milliseconds of the first breath
const SWEEP = 4000; // milliseconds of a sweep from near to far and back
const TAP = 8; // pixels that a tap may move
const LOOK = 1.2; // widths of the grid by which a drag across the window moves the viewpoint
const SLOW = 50; // milliseconds that a drawing may take while something moves: slower ones are made coarser
const COARSEST = 1 / 4; // share of the pixels along each side while something moves
const FINE_COST = 3; // drawings without fine interpolation, which take the time of one with it
const PER_VIEW = 8; // pixels of the picture of an aperture along each side of a view's cell
const PATIENCE = 400; // milliseconds that a fine drawing may take

const { slopes, crop } = content;
/** @type {Point} */
const SIZE = [WIDTH, HEIGHT];
const SCENE = { low: content.depth.low, high: content.depth.high, near: content.near, size: SIZE };
const HAS_VIEWS = content.views.pictures.length > 1;
const [NEAR, FAR] = content.near > 0 ? [slopes.at(-1), slopes[0]] : [slopes[0], slopes.at(-1)];
/** @type {Lens} */
const WHOLE = { slope: content.start.slope, x: 0, y: 0, aperture: 2 * Math.max(...REACH), shape: content.shape, tiltX: 0, tiltY: 0 };
if (content.aperture) SHAPES.own = shapeOf(content.aperture, WHOLE.aperture);
/** @type {Place} */
const CENTRE = { zoom: 1, x: (crop[0] + crop[2]) / 2, y: (crop[1] + crop[3]) / 2 };
const LIMITS = { low: slopes[0], high: slopes.at(-1), reach: REACH };

let lens = { ...WHOLE };
let place = { ...CENTRE };
const options = { show: "picture", compares: false, left: 0, right: Math.min(1, content.methods.length - 1), wipe: 0.5, difference: false };
/** @type {Drawing | null} */
let drawing = null;
let readyAt = 0; // milliseconds after which the lens could draw
let isRequested = false;
let lastChange = -Infinity;
let fineness = 1; // share of the pixels along each side
let fullTime = 0; // milliseconds that a drawing of all pixels takes, about
let cost = 0; // of the last drawing, in such drawings; 0 once its time is known
/** @type {ReturnType<typeof setTimeout> | undefined} */
let resting;
/** @type {((now: number) => boolean) | null} */
let motion = null; // changes the state once a frame, until it returns false

/** @param {string} text */
function say(text) {
  find("status").textContent = text;
  // It fades out some seconds after each text.
  for (const animation of find("status").getAnimations()) {
    animation.cancel();
    animation.play();
  }
}

/** Say why a picture cannot be shown. @param {any} error */
function explain(error) {
  say(error.message);
}

/** A slope as people read it: the field's number, and the distance where the cameras are known. @param {number} slope */
function named(slope) {
  const number = `${content.quantity} ${slope.toFixed(2)}`;
  return content.dioptres ? `${number}, ${distanceOf(slope, content.dioptres)}` : number;
}

/** @returns {Point} */
function windowSize() {
  return [stage.clientWidth, stage.clientHeight];
}

function currentBox() {
  return boxOf(place, windowSize(), crop, SIZE);
}

// Drawing.

/** Draw at the next frame, and once more when nothing has changed for a while. */
function changed() {
  lastChange = performance.now();
  request();
}

function request() {
  if (isRequested) return;
  isRequested = true;
  requestAnimationFrame((now) => {
    isRequested = false;
    clearTimeout(resting);
    // A drawing that is asked for before the last one is finished would wait in a queue, and come too late.
    if (isDrawing()) {
      request();
      return;
    }
    if (motion && !motion(now)) motion = null;
    if (motion) lastChange = now;
    paint(false);
    if (motion) request();
    else resting = setTimeout(rest, REST);
  });
}

/** Whether the lens still draws; if not, the time that it took decides how fine the next drawing is. */
function isDrawing() {
  const time = drawing ? drawing.took() : 0;
  if (time === null) return true;
  if (cost > 0) {
    fullTime = time / cost;
    cost = 0;
    fineness = [1, 1 / 2, COARSEST].find((share) => share ** 2 * fullTime < SLOW) || COARSEST;
  }
  return false;
}

function rest() {
  if (motion || isRequested) return;
  if (isDrawing()) {
    resting = setTimeout(rest, REST);
    return;
  }
  paint(true);
  share();
}

/** @param {boolean} isAtRest */
function paint(isAtRest) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const [width, height] = windowSize().map((length) => Math.max(1, Math.round(ratio * length)));
  for (const canvas of [liveCanvas, flatCanvas]) {
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  }
  const box = boxOf(place, [width, height], crop, SIZE);
  const isLive = drawing !== null && options.show === "picture" && !options.compares;
  const layer = flatLayer(isLive, isAtRest);
  const isShown = layer !== null && paintFlat(layer, box);
  // At rest, a plane that is still decoded follows soon.
  if (drawing && isLive && !(isAtRest && layer)) {
    const isFine = isAtRest && FINE_COST * fullTime < PATIENCE;
    const share = isAtRest ? 1 : fineness;
    cost = share ** 2 * (isFine ? FINE_COST : 1);
    drawing.draw(lens, share, isFine);
    drawing.show(box);
  }
  flatCanvas.classList.toggle("shown", isShown);
  stage.dataset.by = isShown ? layer : isLive ? "lens" : "";
  if (isShown || isLive) find("first").hidden = true;
  stage.dataset.slope = lens.slope;
  stage.dataset.rests = String(isAtRest && (isShown || !layer));
  controls();
}

/** What the flat canvas shows: `compare`, `sharp`, `map`, `plane`, or nothing where the lens is shown.
 * @param {boolean} isLive @param {boolean} isAtRest */
function flatLayer(isLive, isAtRest) {
  if (options.compares) return "compare";
  if (options.show !== "picture") return options.show;
  if (!isLive) return "plane";
  const held = heldPlane(slopes, lens, WHOLE, REACH);
  if (held >= 0) bitmapOf(content.methods[0].planes[held]);
  return isAtRest && held >= 0 ? "plane" : null;
}

/** Bitmaps by their address, once they are decoded; others are asked for. @type {Map<string, ImageBitmap>} */
const ready = new Map();

/** @param {string} uri */
function bitmapOf(uri) {
  const bitmap = ready.get(uri);
  if (!bitmap) {
    decode(uri).then((made) => {
      if (ready.has(uri)) return;
      ready.set(uri, made);
      paint(performance.now() - lastChange >= REST);
    }, explain);
  }
  return bitmap;
}

/** Whether it could be drawn: its pictures are decoded. @param {string} layer @param {Box} box */
function paintFlat(layer, box) {
  const plane = nearestPlane(slopes, lens.slope);
  if (layer === "compare") return paintComparison(plane, box);
  const uri = layer === "plane" ? content.methods[0].planes[plane] : content[layer];
  const bitmap = bitmapOf(uri);
  if (!bitmap) return false;
  clear();
  flat.drawImage(bitmap, box.left, box.top, box.width, box.height);
  return true;
}

function clear() {
  flat.globalCompositeOperation = "source-over";
  flat.filter = "none";
  flat.fillStyle = "#000";
  flat.fillRect(0, 0, flatCanvas.width, flatCanvas.height);
}

const TIMES = 8; // by which differences are multiplied

/** @param {number} plane @param {Box} box */
function paintComparison(plane, box) {
  const [left, right] = [options.left, options.right].map((method) => bitmapOf(content.methods[method].planes[plane]));
  if (!left || !right) return false;
  clear();
  const whole = /** @type {const} */ ([box.left, box.top, box.width, box.height]);
  flat.drawImage(left, ...whole);
  if (options.difference) {
    flat.globalCompositeOperation = "difference";
    flat.drawImage(right, ...whole);
    flat.globalCompositeOperation = "lighter";
    for (let times = 1; times < TIMES; times *= 2) flat.drawImage(flatCanvas, 0, 0);
    flat.globalCompositeOperation = "source-over";
    return true;
  }
  const edge = box.left + options.wipe * box.width;
  flat.save();
  flat.beginPath();
  flat.rect(edge, 0, flatCanvas.width, flatCanvas.height);
  flat.clip();
  flat.drawImage(right, ...whole);
  flat.restore();
  flat.fillStyle = "#fff";
  flat.fillRect(edge - 1, Math.max(0, box.top), 2, Math.min(box.height, flatCanvas.height));
  return true;
}

// The state.

/** @param {Partial<Lens>} part */
function setLens(part) {
  lens = { ...lens, ...part };
  lens.x = Math.min(REACH[0], Math.max(-REACH[0], lens.x));
  lens.y = Math.min(REACH[1], Math.max(-REACH[1], lens.y));
  lens.aperture = Math.min(WHOLE.aperture, Math.max(0, lens.aperture));
  changed();
}

/** Change numbers of the lens evenly; at once for people who prefer reduced motion.
 * @param {Partial<Record<LensNumber, number>>} target */
function moveTo(target) {
  const from = { ...lens };
  const start = performance.now();
  motion = (now) => {
    const share = calm.matches ? 1 : Math.min(1, Math.max(0, (now - start) / TO_FOCUS));
    const eased = share * share * (3 - 2 * share);
    for (const [name, value] of Object.entries(target)) {
      const key = /** @type {LensNumber} */ (name);
      lens[key] = share === 1 ? value : from[key] + eased * (value - from[key]);
    }
    return share < 1;
  };
  changed();
}

function stop() {
  motion = null;
  find("sweep").setAttribute("aria-pressed", "false");
}

/** Put the focus on a point of the picture. @param {Point} at */
function focusAt(at) {
  stop();
  if (options.show !== "picture") choose("picture");
  const shown = visiblePoint(lens, at, (point) => disparityOf(pixelAt(point)), SCENE);
  const point = disparityNear(shown);
  if (point.source === "unknown") {
    say("Nothing to focus on there: the disparity is unknown.");
    return;
  }
  const slope = focusOn(lens, shown, point.disparity);
  say(`${point.source === "neighbour" ? "Focus on the nearest known point" : "Focus"}: ${named(point.disparity)}.`);
  moveTo({ slope });
}

function sweep() {
  if (find("sweep").getAttribute("aria-pressed") === "true") {
    stop();
    changed();
    return;
  }
  stop();
  if (options.show !== "picture") choose("picture");
  find("sweep").setAttribute("aria-pressed", "true");
  const begin = Math.acos(Math.min(1, Math.max(-1, 1 - 2 * nearness(lens.slope))));
  const start = performance.now();
  motion = (now) => {
    setSlope(0.5 - 0.5 * Math.cos(begin + (2 * Math.PI * (now - start)) / SWEEP));
    return true;
  };
  changed();
}

/** Share of the way from the far end to the near one. @param {number} slope */
function nearness(slope) {
  return NEAR === FAR ? 0 : (slope - FAR) / (NEAR - FAR);
}

/** @param {number} share */
function setSlope(share) {
  lens = { ...lens, slope: FAR + share * (NEAR - FAR) };
}

function reset() {
  stop();
  place = { ...CENTRE };
  moveTo({ x: 0, y: 0, aperture: WHOLE.aperture, tiltX: 0, tiltY: 0, slope: WHOLE.slope });
  lens.shape = WHOLE.shape;
}

/** @param {string} show */
function choose(show) {
  options.show = show;
  if (show !== "picture" && options.compares) compare(false);
  find(`show_${show}`).checked = true;
  changed();
}

/** @param {boolean} isOn */
function compare(isOn) {
  options.compares = isOn;
  if (isOn) choose("picture");
  if (find("compare")) find("compare").checked = isOn;
  changed();
}

// Controls that mirror the state.

function controls() {
  const plane = nearestPlane(slopes, lens.slope);
  const isTied = options.compares || (!drawing && options.show === "picture");
  const focus = isTied ? content.titles[plane] : named(lens.slope);
  /** @type {[string, number, string][]} */
  const sliders = [
    ["focus", nearness(lens.slope), focus],
    ["aperture", lens.aperture, `${lens.aperture.toFixed(1)} view steps`],
    ["across", lens.x, lens.x.toFixed(1)],
    ["down", lens.y, lens.y.toFixed(1)],
    ["tilt_across", lens.tiltX, lens.tiltX.toFixed(2)],
    ["tilt_down", lens.tiltY, lens.tiltY.toFixed(2)],
  ];
  for (const [name, value, text] of sliders) {
    if (!find(name)) continue;
    find(name).value = value;
    find(name).setAttribute("aria-valuetext", text);
  }
  find("shape").value = lens.shape;
  find("at_slope").textContent = `${lens.slope.toFixed(3)} ${content.unit}`;
  if (content.dioptres) find("at_distance").textContent = distanceOf(lens.slope, content.dioptres);
  const alpha = content.quantity === "slope" && lens.slope < 1 ? (1 / (1 - lens.slope)).toFixed(3) : "none";
  find("at_alpha").textContent = alpha;
  find("at_method").textContent = stage.dataset.by === "plane" ? `${content.methods[0].name}, ${content.titles[plane]}` : stage.dataset.by || "";
  stage.setAttribute("aria-label", `Picture, ${focus}. Tap or press Enter to focus; arrows look around.`);
}

// The address and messages from a page around this one.

function addressNow() {
  return addressOf(lens, place, WHOLE);
}

function share() {
  const kept = ["embed", "plain"].filter((name) => new URLSearchParams(location.hash.slice(1)).has(name));
  const address = [...kept, addressNow()].join("&");
  if (address === location.hash.slice(1)) return;
  history.replaceState(null, "", `#${address}`);
  if (parent !== window) parent.postMessage({ lfref: addressNow() }, "*");
}

/** @param {string} text */
function follow(text) {
  const state = stateOf(text, WHOLE, CENTRE, LIMITS);
  [lens, place] = [state.lens, state.place];
  document.body.classList.toggle("embed", document.body.classList.contains("embed") || state.names.includes("embed"));
  changed();
  return state.names.some((name) => name in FIELDS || name === "z");
}

addEventListener("hashchange", () => {
  stop();
  follow(location.hash.slice(1));
});
addEventListener("message", (event) => {
  if (event.source !== parent || parent === window || typeof event.data?.lfref !== "string") return;
  stop();
  follow(event.data.lfref);
});

// Gestures.

/** @type {Map<number, { x: number, y: number, startX: number, startY: number }>} */
const fingers = new Map();
let hasPinched = false;
let hasMoved = false;

/** @param {PointerEvent | WheelEvent} event @returns {Point} */
function inWindow(event) {
  const box = stage.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

stage.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => {
  if (event.button > 0) return;
  stop();
  const [x, y] = inWindow(event);
  fingers.set(event.pointerId, { x, y, startX: x, startY: y });
  stage.setPointerCapture(event.pointerId);
  if (fingers.size === 1) hasPinched = hasMoved = false;
  else hasPinched = true;
});

stage.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => {
  const finger = fingers.get(event.pointerId);
  if (!finger) return;
  const [x, y] = inWindow(event);
  const before = [...fingers.values()].map((each) => ({ ...each }));
  const [dx, dy] = [x - finger.x, y - finger.y];
  if (Math.hypot(x - finger.startX, y - finger.startY) > TAP) hasMoved = true;
  [finger.x, finger.y] = [x, y];
  if (!hasMoved && !hasPinched) return;
  if (fingers.size === 2) pinch(before, [...fingers.values()]);
  else if (fingers.size === 1 && !hasPinched) drag(dx, dy, event.shiftKey, event.ctrlKey || event.metaKey);
});

for (const name of ["pointerup", "pointercancel"]) {
  stage.addEventListener(name, (/** @type {PointerEvent} */ event) => {
    const finger = fingers.get(event.pointerId);
    fingers.delete(event.pointerId);
    if (!finger || name === "pointercancel" || hasMoved || hasPinched) return;
    mark(finger.x, finger.y);
    const at = pointUnder(currentBox(), finger.x, finger.y);
    if (Math.min(...at) >= 0 && Math.max(...at) <= 1) focusAt(at);
  });
}

/** Look around; tilt the focal plane; or move the enlarged picture. @param {number} dx @param {number} dy @param {boolean} tilts @param {boolean} moves */
function drag(dx, dy, tilts, moves) {
  if (options.compares) {
    options.wipe = Math.min(1, Math.max(0, options.wipe + dx / currentBox().width));
    find("wipe").value = 100 * options.wipe;
    changed();
  } else if (moves) pan(dx, dy);
  else if (tilts) tilt(dx, dy);
  else if (HAS_VIEWS) {
    if (options.show !== "picture") choose("picture");
    // Near things follow the finger.
    const [width, height] = windowSize();
    const step = (2 * LOOK * Math.max(...REACH)) / Math.min(width, height);
    setLens({ x: lens.x + content.near * step * dx, y: lens.y + content.near * step * dy });
  }
}

/** @param {number} dx @param {number} dy */
function tilt(dx, dy) {
  const [width, height] = windowSize();
  const range = slopes.at(-1) - slopes[0] || 1;
  setLens({ tiltX: lens.tiltX + (2 * range * dx) / width, tiltY: lens.tiltY + (2 * range * dy) / height });
}

/** @param {number} dx @param {number} dy */
function pan(dx, dy) {
  const box = currentBox();
  place = inside({ zoom: place.zoom, x: place.x - dx / box.width, y: place.y - dy / box.height }, crop);
  changed();
}

/** @param {{ x: number, y: number }[]} before @param {{ x: number, y: number }[]} after */
function pinch(before, after) {
  const [was, is] = [before, after].map(([a, b]) => ({ x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, width: Math.hypot(a.x - b.x, a.y - b.y) }));
  const isEnlarged = place.zoom > 1;
  if (was.width > 0) place = zoomed(place, is.width / was.width, pointUnder(currentBox(), is.x, is.y), crop);
  if (isEnlarged) pan(is.x - was.x, is.y - was.y);
  else if (place.zoom === 1) tilt(is.x - was.x, is.y - was.y);
  changed();
}

stage.addEventListener("wheel", (/** @type {WheelEvent} */ event) => {
  event.preventDefault();
  stop();
  const by = event.deltaY * (event.deltaMode === 1 ? 16 : 1);
  place = zoomed(place, Math.exp(-0.002 * by), pointUnder(currentBox(), ...inWindow(event)), crop);
  changed();
}, { passive: false });

/** @param {number} x @param {number} y */
function mark(x, y) {
  const ring = find("mark");
  [ring.style.left, ring.style.top] = [`${x}px`, `${y}px`];
  ring.classList.remove("fades");
  void ring.offsetWidth; // so that the animation begins anew
  ring.classList.add("fades");
}

// Tilting a phone looks around; iOS asks first.
/** @type {{ beta: number, gamma: number } | null} */
let level = null;

addEventListener("deviceorientation", (event) => {
  if (event.beta === null || event.gamma === null || calm.matches || !HAS_VIEWS || motion) return;
  level ??= { beta: event.beta, gamma: event.gamma };
  const [across, down] = [(event.gamma - level.gamma) / 20, (event.beta - level.beta) / 20];
  if (Math.hypot(across, down) < 0.02 && lens.x === 0 && lens.y === 0) return;
  setLens({ x: content.near * across * REACH[0], y: content.near * down * REACH[1] });
});

// Keys.

/** @param {number} x @param {number} y */
function look(x, y) {
  setLens({ x: lens.x + (content.near * x * Math.max(...REACH)) / 10, y: lens.y + (content.near * y * Math.max(...REACH)) / 10 });
}

/** @param {number} by  Share of the way from far to near. */
function refocus(by) {
  const share = Math.min(1, Math.max(0, nearness(lens.slope) + by));
  setLens({ slope: FAR + share * (NEAR - FAR) });
  say(`Focus: ${named(lens.slope)}.`);
}

/** @param {number} factor */
function zoomBy(factor) {
  place = zoomed(place, factor, [place.x, place.y], crop);
  changed();
}

/** @type {Record<string, (event: KeyboardEvent) => void>} */
const KEYS = {
  ArrowLeft: (event) => (event.shiftKey ? tilt(-20, 0) : look(-1, 0)),
  ArrowRight: (event) => (event.shiftKey ? tilt(20, 0) : look(1, 0)),
  ArrowUp: (event) => (event.shiftKey ? tilt(0, -20) : look(0, -1)),
  ArrowDown: (event) => (event.shiftKey ? tilt(0, 20) : look(0, 1)),
  PageUp: () => refocus(0.02),
  PageDown: () => refocus(-0.02),
  Home: () => refocus(1),
  End: () => refocus(-1),
  "[": () => setLens({ aperture: lens.aperture - WHOLE.aperture / 10 }),
  "]": () => setLens({ aperture: lens.aperture + WHOLE.aperture / 10 }),
  "+": () => zoomBy(1.25),
  "=": () => zoomBy(1.25),
  "-": () => zoomBy(0.8),
  0: reset,
  Escape: reset,
  Enter: () => focusAt([place.x, place.y]),
  " ": sweep,
  f: fullScreen,
  s: save,
};
stage.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
  if (!KEYS[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  if (event.key !== " ") stop();
  KEYS[event.key](event);
});

// Sliders, drawer and buttons.

/** @param {string} name @param {(value: number) => void} act */
function onSlider(name, act) {
  find(name)?.addEventListener("input", (/** @type {any} */ event) => {
    stop();
    act(Number(event.target.value));
  });
}
onSlider("focus", (value) => {
  if (options.show !== "picture") choose("picture");
  setLens({ slope: FAR + value * (NEAR - FAR) });
});
onSlider("aperture", (aperture) => setLens({ aperture }));
onSlider("across", (x) => setLens({ x }));
onSlider("down", (y) => setLens({ y }));
onSlider("tilt_across", (tiltX) => setLens({ tiltX }));
onSlider("tilt_down", (tiltY) => setLens({ tiltY }));
onSlider("wipe", (value) => {
  options.wipe = value / 100;
  compare(true);
});
for (const name of /** @type {const} */ (["left", "right"])) {
  find(name)?.addEventListener("input", (/** @type {any} */ event) => {
    options[name] = Number(event.target.value);
    compare(true);
  });
}
find("compare")?.addEventListener("change", (/** @type {any} */ event) => compare(event.target.checked));
find("difference")?.addEventListener("change", (/** @type {any} */ event) => {
  options.difference = event.target.checked;
  compare(true);
});
find("shape").addEventListener("input", (/** @type {any} */ event) => setLens({ shape: event.target.value }));

/** Take the aperture that a picture file shows: white is open, black and transparent are closed. @param {File} file */
async function openAperture(file) {
  const picture = await createImageBitmap(file).catch(() => null);
  if (!picture) {
    say(`${file.name} is not a picture that this browser reads.`);
    return;
  }
  const n = Math.round(WHOLE.aperture) + 1;
  const scratch = Object.assign(document.createElement("canvas"), { width: PER_VIEW * n, height: PER_VIEW * n });
  const drawing = /** @type {CanvasRenderingContext2D} */ (scratch.getContext("2d", { willReadFrequently: true }));
  drawing.fillRect(0, 0, scratch.width, scratch.height);
  const scale = scratch.width / Math.max(picture.width, picture.height);
  const [width, height] = [scale * picture.width, scale * picture.height];
  drawing.imageSmoothingQuality = "high";
  drawing.drawImage(picture, (scratch.width - width) / 2, (scratch.height - height) / 2, width, height);
  const rows = cellMeans(drawing.getImageData(0, 0, scratch.width, scratch.height).data, n, PER_VIEW);
  if (!rows.flat().some((weight) => weight > 0)) {
    say(`${file.name} is black: nothing would be open. White is open.`);
    return;
  }
  SHAPES.picture = shapeOf(rows, WHOLE.aperture);
  find("picture_shape").hidden = false;
  setLens({ shape: "picture" });
}
find("shape_file").addEventListener("change", (/** @type {any} */ event) => event.target.files[0] && openAperture(event.target.files[0]));
for (const show of ["picture", "sharp", "map"]) find(`show_${show}`).addEventListener("change", () => choose(show));
find("sweep").addEventListener("click", sweep);
find("reset").addEventListener("click", reset);
find("save").addEventListener("click", () => save());
find("loop").addEventListener("click", saveLoop);
find("link").addEventListener("click", copyLink);
find("full").addEventListener("click", fullScreen);
find("tilting")?.addEventListener("click", askToTilt);

/** @param {boolean} isOpen */
function openDrawer(isOpen) {
  find("drawer").hidden = !isOpen;
  find("more").setAttribute("aria-expanded", String(isOpen));
  document.body.classList.toggle("opened", isOpen);
  changed();
  if (isOpen) find("close").focus();
  else find("more").focus();
}
find("more").addEventListener("click", () => openDrawer(find("drawer").hidden));
find("close").addEventListener("click", () => openDrawer(false));
find("drawer").addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
  if (event.key === "Escape") openDrawer(false);
});

// Taking away.

function fileName() {
  const name = document.title.replace(/[^\p{L}\p{N}]+/gu, "_").replace(/^_|_$/g, "") || "picture";
  return options.show === "picture" ? `${name}_${content.quantity}_${lens.slope.toFixed(2)}` : `${name}_${options.show}`;
}

/** @param {Blob} blob @param {string} name */
function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

/** The picture in its own pixels, without the edges that are cropped. */
function pictureNow() {
  const made = document.createElement("canvas");
  const [left, top, right, bottom] = [crop[0] * WIDTH, crop[1] * HEIGHT, crop[2] * WIDTH, crop[3] * HEIGHT].map(Math.round);
  [made.width, made.height] = [right - left, bottom - top];
  const context = /** @type {CanvasRenderingContext2D} */ (made.getContext("2d"));
  const plane = nearestPlane(slopes, lens.slope);
  const uri = options.show === "picture" ? content.methods[0].planes[plane] : content[options.show];
  const isFlat = options.show !== "picture" || !drawing || stage.dataset.by === "plane";
  /** @param {CanvasImageSource} from */
  const put = (from) => {
    context.drawImage(from, -left, -top, WIDTH, HEIGHT);
    return made;
  };
  if (isFlat || !drawing) return decode(uri).then(put);
  drawing.draw(lens);
  const pixels = drawing.pixels();
  const whole = new OffscreenCanvas(pixels.width, pixels.height);
  /** @type {OffscreenCanvasRenderingContext2D} */ (whole.getContext("2d")).putImageData(pixels, 0, 0);
  return Promise.resolve(put(whole));
}

function save() {
  pictureNow().then((made) => made.toBlob((blob) => blob && download(blob, `${fileName()}.png`)));
}

/** A sweep from near to far and back as a video. */
function saveLoop() {
  if (!drawing || typeof MediaRecorder === "undefined") {
    say("This browser cannot record videos.");
    return;
  }
  const types = ["video/mp4;codecs=avc1.42E01E", "video/mp4", "video/webm;codecs=vp9", "video/webm"];
  const type = types.find((each) => MediaRecorder.isTypeSupported(each));
  if (!type) {
    say("This browser cannot record videos.");
    return;
  }
  stop();
  choose("picture");
  compare(false);
  const kept = { ...lens };
  const recorder = new MediaRecorder(liveCanvas.captureStream(30), { mimeType: type, videoBitsPerSecond: 8e6 });
  /** @type {Blob[]} */
  const parts = [];
  recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
  recorder.addEventListener("stop", () => {
    download(new Blob(parts, { type }), `${fileName()}.${type.startsWith("video/mp4") ? "mp4" : "webm"}`);
    say("The loop is saved.");
  });
  say("Recording for four seconds.");
  recorder.start();
  const start = performance.now();
  motion = (now) => {
    const share = Math.min(1, (now - start) / SWEEP);
    setSlope(0.5 + 0.5 * Math.cos(2 * Math.PI * share));
    if (share < 1) return true;
    recorder.stop();
    lens = kept;
    return false;
  };
  changed();
}

function copyLink() {
  share();
  const done = () => say("The link is copied.");
  const failed = () => say(`Copy this address: ${location.href}`);
  if (navigator.clipboard) navigator.clipboard.writeText(location.href).then(done, failed);
  else failed();
}

function fullScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen?.().catch(() => say("This browser has no full screen here."));
}

function askToTilt() {
  const asks = /** @type {any} */ (globalThis).DeviceOrientationEvent?.requestPermission;
  level = null;
  if (asks) asks().then((/** @type {string} */ answer) => say(answer === "granted" ? "Tilt the phone to look around." : "Tilting is not allowed."));
  else say("Tilt the phone to look around, if it has the sensor.");
}

// The beginning.

/** Focus breathes and the viewpoint sways, once: that is what the page can do. */
function introduce() {
  if (calm.matches || !HAS_VIEWS) return;
  const from = { ...lens };
  const start = performance.now();
  say("Tap to focus, drag to look around.");
  motion = (now) => {
    const share = Math.min(1, (now - start) / INTRO);
    const swing = Math.sin(2 * Math.PI * share) * Math.sin(Math.PI * share);
    const to = Math.abs(NEAR - from.slope) > Math.abs(FAR - from.slope) ? NEAR : FAR;
    lens = { ...from, slope: from.slope + 0.35 * Math.abs(swing) * (to - from.slope), x: 0.4 * REACH[0] * swing };
    if (share === 1) lens = from;
    return share < 1;
  };
  changed();
}

for (const [name, most] of /** @type {[string, number][]} */ ([["aperture", WHOLE.aperture], ["across", REACH[0]], ["down", REACH[1]]])) {
  if (!find(name)) continue;
  find(name).max = most;
  if (name !== "aperture") find(name).min = -most;
}
for (const name of ["tilt_across", "tilt_down"]) {
  const most = 4 * (slopes.at(-1) - slopes[0] || 1);
  find(name).max = most;
  find(name).min = -most;
}
if (find("right")) find("right").value = options.right;
const isGiven = follow(location.hash.slice(1));
new ResizeObserver(changed).observe(stage);

async function begin() {
  // The first picture is painted before the views are decoded, which keeps this thread busy.
  await find("first").decode().catch(() => {});
  await new Promise((painted) => requestAnimationFrame(() => setTimeout(painted)));
  try {
    drawing = await newLens(liveCanvas);
  } catch (error) {
    explain(error);
    return;
  }
  liveCanvas = find("live"); // another one where the graphics processor could not draw
  readyAt = performance.now();
  changed();
  if (!isGiven) introduce();
}
if (HAS_VIEWS) begin();
