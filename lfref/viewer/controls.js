// Controls of the page: each changes the state, and the drawing depends on the state alone.

const find = (name) => document.getElementById(name);
const stage = find("stage");
const flat = find("flat");
const lensCanvas = find("lens");
const context = flat.getContext("2d");
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const PER_PLANE = 160; // milliseconds of a sweep
const TO_FOCUS = 250; // milliseconds until a point that was clicked is in focus

const state = { mode: "planes", plane: content.start, left: 0, right: Math.min(1, content.methods.length - 1), wipe: 1 };
const ends = [0, 1].map((axis) => Math.max(...content.views.cameras.map((camera) => Math.abs(camera[axis]))));
const whole = { slope: content.slopes[content.start], aperture: 2 * Math.max(...ends), shape: "square", across: 0, down: 0, tiltAcross: 0, tiltDown: 0 };
const settings = { ...whole };
let lens = null;
let motion = 0;

function report(text) {
  find("status").textContent = text;
}

function drawPlanes() {
  const under = Math.floor(state.plane);
  const over = Math.min(under + 1, content.slopes.length - 1);
  const share = state.plane - under;
  const method = (number, clip) => {
    const planes = drawn[number];
    if (!planes || !planes[under]) return;
    context.save();
    context.beginPath();
    context.rect(clip, 0, WIDTH - clip, HEIGHT);
    context.clip();
    context.drawImage(planes[under], 0, 0);
    if (share > 0 && planes[over]) {
      context.globalAlpha = share;
      context.drawImage(planes[over], 0, 0);
    }
    context.restore();
  };
  method(state.left, 0);
  const edge = Math.round(state.wipe * WIDTH);
  if (state.wipe < 1) {
    method(state.right, edge);
    context.fillStyle = "#fff";
    context.fillRect(edge - 1, 0, 2, HEIGHT);
  }
}

const drawn = content.methods.map(() => null);

async function load(number) {
  if (!drawn[number]) drawn[number] = await Promise.all(content.methods[number].planes.map(decode));
}

async function draw() {
  const mode = state.mode;
  if (mode === "lens") {
    lens ??= newLens(lensCanvas);
    const drawLens = await lens;
    if (state.mode !== mode) return;
    drawLens(settings);
  } else if (mode === "planes") {
    await load(state.left);
    if (state.wipe < 1) await load(state.right);
    if (state.mode !== mode) return;
    drawPlanes();
  } else {
    const picture = await decode(content[mode]);
    if (state.mode !== mode) return;
    context.drawImage(picture, 0, 0, WIDTH, HEIGHT);
  }
  find("first").hidden = true;
  flat.hidden = mode === "lens";
  lensCanvas.hidden = mode !== "lens";
  stage.dataset.drawn = mode;
}

function show() {
  const plane = Math.round(state.plane);
  find("plane").value = plane;
  find("plane_text").textContent = content.titles[plane];
  find("plane").setAttribute("aria-valuetext", content.titles[plane]);
  find("slope").value = settings.slope;
  find("slope_text").textContent = `${content.quantity} ${settings.slope.toFixed(2)}`;
  stage.dataset.plane = plane;
  stage.dataset.slope = state.mode === "lens" ? settings.slope : content.slopes[plane];
  for (const part of document.querySelectorAll("[data-mode]")) {
    if (part !== stage) part.hidden = part.dataset.mode !== state.mode;
  }
  return draw();
}

function stop() {
  cancelAnimationFrame(motion);
  motion = 0;
  find("sweep").setAttribute("aria-pressed", "false");
}

// Move the focus evenly to its target; at once for people who prefer reduced motion.
function move(values, key, target) {
  stop();
  const from = values[key];
  const start = performance.now();
  const step = (now) => {
    const share = calm.matches ? 1 : Math.min(1, (now - start) / TO_FOCUS);
    values[key] = from + share * (target - from);
    show();
    motion = share < 1 ? requestAnimationFrame(step) : 0;
  };
  step(start);
}

function focusOn(x, y) {
  const point = slopeAt(x, y);
  if (state.mode === "sharp" || state.mode === "map") setMode("planes");
  if (point.source === "unknown") {
    report("The disparity there is unknown: the focus stays.");
    return;
  }
  const plane = nearestPlane(point.slope);
  const what = point.source === "neighbour" ? "The nearest known point" : "The point";
  const isBeyond = content.slopes.length > 1 && (point.slope < content.slopes[0] - 0.5 || point.slope > content.slopes.at(-1) + 0.5);
  report(`${what} is sharp at ${content.quantity} ${point.slope.toFixed(2)}; ${isBeyond ? "that is beyond the planes; nearest plane:" : "nearest plane:"} ${content.titles[plane]}.`);
  if (state.mode === "lens") move(settings, "slope", point.slope);
  else move(state, "plane", plane);
}

function sweep() {
  if (motion) {
    stop();
    return;
  }
  setMode("planes");
  find("sweep").setAttribute("aria-pressed", "true");
  const last = content.slopes.length - 1;
  const start = performance.now() - state.plane * PER_PLANE;
  const step = (now) => {
    const way = ((now - start) / PER_PLANE) % (2 * last || 1);
    const position = way <= last ? way : 2 * last - way;
    state.plane = calm.matches ? Math.round(position) : position;
    show();
    motion = requestAnimationFrame(step);
  };
  motion = requestAnimationFrame(step);
}

// Planes and lens share the focus.
function setMode(mode) {
  if (mode === "lens" && state.mode !== "lens") settings.slope = content.slopes[Math.round(state.plane)];
  if (mode !== "lens" && state.mode === "lens") state.plane = nearestPlane(settings.slope);
  state.mode = mode;
  document.querySelector(`input[name="mode"][value="${mode}"]`).checked = true;
  if (mode !== "planes") stop();
  show();
}

function step(by) {
  stop();
  if (state.mode === "lens") {
    const width = content.slopes.at(-1) - content.slopes[0];
    settings.slope = Math.min(content.slopes.at(-1), Math.max(content.slopes[0], settings.slope + (by * width) / 50));
  } else {
    if (state.mode !== "planes") setMode("planes");
    state.plane = Math.min(content.slopes.length - 1, Math.max(0, Math.round(state.plane) + by));
    report(content.titles[state.plane]);
  }
  show();
}

stage.addEventListener("click", (event) => {
  const box = stage.getBoundingClientRect();
  const [across, down] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  const mark = find("mark");
  mark.hidden = false;
  [mark.style.left, mark.style.top] = [`${100 * across}%`, `${100 * down}%`];
  focusOn(Math.min(WIDTH - 1, Math.floor(across * WIDTH)), Math.min(HEIGHT - 1, Math.floor(down * HEIGHT)));
});

const KEYS = {
  ArrowLeft: () => step(-1),
  ArrowDown: () => step(-1),
  ArrowRight: () => step(1),
  ArrowUp: () => step(1),
  Home: () => step(-content.slopes.length),
  End: () => step(content.slopes.length),
  " ": sweep,
};
stage.addEventListener("keydown", (event) => {
  if (!KEYS[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  KEYS[event.key]();
});

for (const radio of document.querySelectorAll('input[name="mode"]')) {
  radio.addEventListener("change", () => setMode(radio.value));
}
find("plane").addEventListener("input", (event) => {
  stop();
  state.plane = Number(event.target.value);
  show();
});
find("sweep").addEventListener("click", sweep);
for (const name of ["left", "right", "wipe"]) {
  find(name)?.addEventListener("input", (event) => {
    state[name] = Number(event.target.value) / (name === "wipe" ? 100 : 1);
    show();
  });
}
const LENS = { slope: "slope", aperture: "aperture", across: "across", down: "down", tilt_across: "tiltAcross", tilt_down: "tiltDown" };
for (const [name, key] of Object.entries(LENS)) {
  find(name).addEventListener("input", (event) => {
    stop();
    settings[key] = Number(event.target.value);
    show();
  });
}
find("shape").addEventListener("input", (event) => {
  settings.shape = event.target.value;
  show();
});

function resetLens() {
  Object.assign(settings, whole, { slope: content.slopes[Math.round(state.plane)] });
  for (const [name, key] of Object.entries(LENS)) find(name).value = settings[key];
  find("shape").value = settings.shape;
  show();
}
find("reset").addEventListener("click", resetLens);

find("save").addEventListener("click", () => {
  const canvas = state.mode === "lens" ? lensCanvas : flat;
  canvas.toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${state.mode}_${stage.dataset.slope}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
});

// Ranges that depend on the grid of the views.
for (const [name, most] of [["aperture", whole.aperture], ["across", ends[0]], ["down", ends[1]]]) {
  find(name).max = most;
  if (name !== "aperture") find(name).min = -most;
}
if (find("right")) find("right").value = state.right;
resetLens();
