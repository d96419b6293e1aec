// What people do with the page: every control changes the state, and the state alone decides what is drawn.

const find = (name) => document.getElementById(name);
const stage = find("stage");
const flat = find("flat");
const lensCanvas = find("lens");
const context = flat.getContext("2d");
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const PER_PLANE = 160; // milliseconds of a sweep
const TO_FOCUS = 250; // milliseconds until a point that was clicked is in focus

const state = { mode: "planes", plane: held.start, left: 0, right: Math.min(1, held.methods.length - 1), wipe: 1 };
const ends = [0, 1].map((axis) => Math.max(...held.views.cameras.map((camera) => Math.abs(camera[axis]))));
const whole = { slope: held.slopes[held.start], aperture: 2 * Math.max(...ends), shape: "square", across: 0, down: 0, tiltAcross: 0, tiltDown: 0 };
const asked = { ...whole };
let lens = null;
let motion = 0;

function tell(text) {
  find("told").textContent = text;
}

function drawPlanes() {
  const under = Math.floor(state.plane);
  const over = Math.min(under + 1, held.slopes.length - 1);
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

const drawn = held.methods.map(() => null);

async function load(number) {
  if (!drawn[number]) drawn[number] = await Promise.all(held.methods[number].planes.map(decode));
}

async function draw() {
  const mode = state.mode;
  if (mode === "lens") {
    lens ??= newLens(lensCanvas);
    const made = await lens;
    if (state.mode !== mode) return;
    made(asked);
  } else if (mode === "planes") {
    await load(state.left);
    if (state.wipe < 1) await load(state.right);
    if (state.mode !== mode) return;
    drawPlanes();
  } else {
    const picture = await decode(held[mode]);
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
  find("plane_told").textContent = held.titles[plane];
  find("plane").setAttribute("aria-valuetext", held.titles[plane]);
  find("slope").value = asked.slope;
  find("slope_told").textContent = `slope ${asked.slope.toFixed(2)}`;
  stage.dataset.plane = plane;
  stage.dataset.slope = state.mode === "lens" ? asked.slope : held.slopes[plane];
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

// From where the focus is to where it shall be, evenly; at once where people want no motion.
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
  const found = slopeAt(x, y);
  if (state.mode === "sharp" || state.mode === "map") setMode("planes");
  if (found.is === "unknown") {
    tell("Nothing there tells how far away it is: the focus stays.");
    return;
  }
  const plane = nearestPlane(found.slope);
  const how = found.is === "around" ? "What is beside it" : "It";
  const where = held.slopes.length > 1 && (found.slope < held.slopes[0] - 0.5 || found.slope > held.slopes.at(-1) + 0.5);
  tell(`${how} is sharp at slope ${found.slope.toFixed(2)}; ${where ? "that is beyond the planes, the nearest is" : "nearest plane:"} ${held.titles[plane]}.`);
  if (state.mode === "lens") move(asked, "slope", found.slope);
  else move(state, "plane", plane);
}

function sweep() {
  if (motion) {
    stop();
    return;
  }
  setMode("planes");
  find("sweep").setAttribute("aria-pressed", "true");
  const last = held.slopes.length - 1;
  const start = performance.now() - state.plane * PER_PLANE;
  const step = (now) => {
    const way = ((now - start) / PER_PLANE) % (2 * last || 1);
    const place = way <= last ? way : 2 * last - way;
    state.plane = calm.matches ? Math.round(place) : place;
    show();
    motion = requestAnimationFrame(step);
  };
  motion = requestAnimationFrame(step);
}

// The focus goes along from the planes to the lens and back.
function setMode(mode) {
  if (mode === "lens" && state.mode !== "lens") asked.slope = held.slopes[Math.round(state.plane)];
  if (mode !== "lens" && state.mode === "lens") state.plane = nearestPlane(asked.slope);
  state.mode = mode;
  document.querySelector(`input[name="mode"][value="${mode}"]`).checked = true;
  if (mode !== "planes") stop();
  show();
}

function step(by) {
  stop();
  if (state.mode === "lens") {
    const width = held.slopes.at(-1) - held.slopes[0];
    asked.slope = Math.min(held.slopes.at(-1), Math.max(held.slopes[0], asked.slope + (by * width) / 50));
  } else {
    if (state.mode !== "planes") setMode("planes");
    state.plane = Math.min(held.slopes.length - 1, Math.max(0, Math.round(state.plane) + by));
    tell(held.titles[state.plane]);
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
  Home: () => step(-held.slopes.length),
  End: () => step(held.slopes.length),
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
    asked[key] = Number(event.target.value);
    show();
  });
}
find("shape").addEventListener("input", (event) => {
  asked.shape = event.target.value;
  show();
});

function resetLens() {
  Object.assign(asked, whole, { slope: held.slopes[Math.round(state.plane)] });
  for (const [name, key] of Object.entries(LENS)) find(name).value = asked[key];
  find("shape").value = asked.shape;
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

// What depends on the grid of the views.
for (const [name, most] of [["aperture", whole.aperture], ["across", ends[0]], ["down", ends[1]]]) {
  find(name).max = most;
  if (name !== "aperture") find(name).min = -most;
}
if (find("right")) find("right").value = state.right;
resetLens();
