"use strict";
// The lens: refocusing in linear light through any aperture, from any viewpoint, focused on any plane, tilted ones too.
// It runs on the graphics processor in three passes: the weighted sum of the shifted views; a box along each axis, as
// wide as the blur of a cell of the aperture, |slope - disparity| pixels, so that blurred edges show no copies (the
// views between the cameras are missing); and the picture on the screen. The disparity is the mean around a pixel, so
// that the width changes slowly, and what is in focus there has no box, which would blur it. Without a graphics
// processor, the processor computes the sum at half the resolution.

const MOST_VIEWS = 512;
const MOST_TAPS = 24; // pixels of a box along one axis
const LEAST_BOX = 0.25; // pixels: a narrower box changes nothing that can be seen
const IN_FOCUS = 0.25; // pixels of blur per view step up to which there is no box
const FADE = 0.5; // pixels of blur beyond that until there is all of it
const CORNERS = `#version 300 es
in vec2 corner; out vec2 at;
void main() { at = 0.5 * corner + 0.5; gl_Position = vec4(corner, 0.0, 1.0); }`;
const SUM = `#version 300 es
precision highp float; precision highp sampler2DArray;
uniform sampler2DArray views, masks; uniform sampler2D cameras; uniform int n; uniform bool masked, fine;
uniform vec3 focus; uniform vec2 size;
in vec2 at; out vec4 light;
// Cubic interpolation (Catmull-Rom): nine linear ones, of which the four at the corners weigh next to nothing.
vec3 cubic(vec2 place, float view) {
  vec2 pixels = vec2(textureSize(views, 0).xy), position = place * pixels, middle = floor(position - 0.5) + 0.5;
  vec2 f = position - middle;
  vec2 w0 = f * (-0.5 + f * (1.0 - 0.5 * f)), w1 = 1.0 + f * f * (-2.5 + 1.5 * f);
  vec2 w2 = f * (0.5 + f * (2.0 - 1.5 * f)), w3 = f * f * (-0.5 + 0.5 * f), w12 = w1 + w2;
  vec2 p0 = (middle - 1.0) / pixels, p12 = (middle + w2 / w12) / pixels, p3 = (middle + 2.0) / pixels;
  vec4 sum = vec4(0.0);
  sum += w12.x * w0.y * vec4(texture(views, vec3(p12.x, p0.y, view)).rgb, 1.0);
  sum += w0.x * w12.y * vec4(texture(views, vec3(p0.x, p12.y, view)).rgb, 1.0);
  sum += w12.x * w12.y * vec4(texture(views, vec3(p12, view)).rgb, 1.0);
  sum += w3.x * w12.y * vec4(texture(views, vec3(p3.x, p12.y, view)).rgb, 1.0);
  sum += w12.x * w3.y * vec4(texture(views, vec3(p12.x, p3.y, view)).rgb, 1.0);
  return sum.rgb / sum.a;
}
void main() {
  float slope = focus.x + dot(focus.yz, at - 0.5);
  light = vec4(0.0);
  for (int k = 0; k < ${MOST_VIEWS}; k++) {
    if (k >= n) break;
    vec4 camera = texelFetch(cameras, ivec2(k, 0), 0);
    if (camera.z <= 0.0) continue;
    vec2 place = at + slope * camera.xy / size;
    if (any(lessThan(place, vec2(0.0))) || any(greaterThan(place, vec2(1.0)))) continue;
    float weight = camera.z * (masked ? texture(masks, vec3(place, camera.w)).r : 1.0);
    vec3 colour = fine ? cubic(place, camera.w) : texture(views, vec3(place, camera.w)).rgb;
    light += weight * vec4(colour, 1.0);
  }
}`;
const DISPARITY = `
float disparity(vec2 place) {
  ivec2 known = textureSize(disparities, 0);
  return texelFetch(disparities, clamp(ivec2(floor(place * vec2(known))), ivec2(0), known - 1), 0).r;
}`;
// Add the difference of a view to what the reference predicts. The target encodes light as sRGB again.
const RESTORE = `#version 300 es
precision highp float;
uniform sampler2D reference, difference, disparities; uniform vec2 size, camera, from;
in vec2 at; out vec4 light;${DISPARITY}
void main() {
  vec2 place = at;
  for (int k = 0; k < ${PREDICTION_STEPS}; k++) place = at - disparity(place) * camera / size;
  vec3 predicted = texture(reference, place + disparity(place) * from / size).rgb;
  vec3 view = clamp(predicted + texture(difference, at).rgb - ${ZERO_DIFFERENCE}.0 / 255.0, 0.0, 1.0);
  light = vec4(mix(view / 12.92, pow((view + 0.055) / 1.055, vec3(2.4)), step(0.04045, view)), 1.0);
}`;
const BOX = `#version 300 es
precision highp float;
uniform sampler2D sum, surroundings; uniform vec3 focus; uniform vec2 size, viewpoint; uniform ivec2 axis; uniform float cell;
uniform bool last; uniform ivec2 pixels;
in vec2 at; out vec4 light;
// Integral from 0 to x of the kernel of cubic interpolation (Catmull-Rom).
float integral(float x) {
  float a = min(abs(x), 2.0);
  float inner = a + a * a * a * (-2.5 / 3.0 + 0.375 * a);
  float outer = -1.0 / 6.0 + a * (2.0 + a * (-2.0 + a * (2.5 / 3.0 - 0.125 * a)));
  return sign(x) * (a < 1.0 ? inner : outer);
}
vec3 around(vec2 place) {
  ivec2 known = textureSize(surroundings, 0);
  return texelFetch(surroundings, clamp(ivec2(floor(place * vec2(known))), ivec2(0), known - 1), 0).rgb;
}
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  float slope = focus.x + dot(focus.yz, at - 0.5);
  vec2 seen = at + (slope - around(at).x) * viewpoint / size;
  float scale = float(pixels.x) / size.x;
  vec3 disparity = around(seen);
  float blur = max(max(disparity.y - slope, slope - disparity.z), 0.0); // the least one around the pixel
  float share = clamp((blur - ${IN_FOCUS}) / ${FADE}, 0.0, 1.0);
  float width = min(cell * scale * share * abs(slope - disparity.x), float(${MOST_TAPS}));
  // The mean over the box of what lies between the pixels: shares of pixels alone would blur more than the box.
  float reach = 0.5 * max(width, ${LEAST_BOX});
  light = vec4(0.0);
  int last_tap = width < ${LEAST_BOX} ? 0 : int(ceil(reach + 2.0)) - 1;
  for (int k = -last_tap; k <= last_tap; k++) {
    float weight = (integral(float(k) + reach) - integral(float(k) - reach)) / (2.0 * reach);
    ivec2 place = pixel + k * axis;
    if (any(lessThan(place, ivec2(0))) || any(greaterThanEqual(place, pixels))) continue;
    light += weight * texelFetch(sum, place, 0);
  }
  if (!last) return;
  vec3 mean = clamp(light.rgb / max(light.a, 1e-6), 0.0, 1.0);
  light = vec4(mix(12.92 * mean, 1.055 * pow(mean, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, mean)), 1.0);
}`;
const SHOW = `#version 300 es
precision highp float;
uniform sampler2D picture; uniform vec4 box; uniform vec2 window, used;
in vec2 at; out vec4 shown;
void main() {
  vec2 place = (vec2(at.x, 1.0 - at.y) * window - box.xy) / box.zw;
  bool outside = any(lessThan(place, vec2(0.0))) || any(greaterThan(place, vec2(1.0)));
  vec2 half_pixel = 0.5 / vec2(textureSize(picture, 0));
  shown = outside ? vec4(0.0, 0.0, 0.0, 1.0) : texture(picture, clamp(place * used, half_pixel, used - half_pixel));
}`;

/**
 * @typedef {{ draw: (lens: Lens, share?: number, fine?: boolean) => void, show: (box: Box) => void, took: () => number | null,
 *   pixels: () => ImageData }} Drawing
 * Refocus, with a share of the pixels along each side, with fine interpolation or not; show the picture in a box of the
 * canvas; the milliseconds that the last drawing took, or null while it is not finished; the pixels of the picture.
 */

/** @param {WebGL2RenderingContext} gl @param {string} text */
function programOf(gl, text) {
  const program = gl.createProgram();
  for (const [kind, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, CORNERS], [gl.FRAGMENT_SHADER, text]])) {
    const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) || "shader");
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, "corner");
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "program");
  return { program, at: (/** @type {string} */ name) => gl.getUniformLocation(program, name) };
}

/** The lens on the graphics processor, or null where there is none that can. @param {HTMLCanvasElement} canvas
 * @param {ImageBitmap[]} images @param {ImageBitmap[] | null} masks @returns {Drawing | null} */
function glLens(canvas, images, masks) {
  const gl = canvas.getContext("webgl2", { preserveDrawingBuffer: true, antialias: false, alpha: false });
  if (!gl || !gl.getExtension("EXT_color_buffer_float")) return null;
  if (images.length > Math.min(MOST_VIEWS, gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS))) return null;
  const [height, width] = content.views.size;
  if (Math.max(height, width, HEIGHT, WIDTH) > gl.getParameter(gl.MAX_TEXTURE_SIZE)) return null;
  const [sum, box, show] = [SUM, BOX, SHOW].map((text) => programOf(gl, text));
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);

  let unit = 0;
  const textureOf = (/** @type {number} */ kind, /** @type {number} */ filter) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, gl.createTexture());
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(kind, side, gl.CLAMP_TO_EDGE);
    for (const each of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, each, filter);
    return unit++;
  };
  const layersOf = (/** @type {ImageBitmap[]} */ layers, /** @type {number} */ stored, /** @type {number} */ format, filled = [...layers.keys()]) => {
    const at = textureOf(gl.TEXTURE_2D_ARRAY, gl.LINEAR);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, stored, layers[0].width, layers[0].height, layers.length);
    for (const k of filled) {
      const { width, height } = layers[k];
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, k, width, height, 1, format, gl.UNSIGNED_BYTE, layers[k]);
    }
    return at;
  };
  const known = textureOf(gl.TEXTURE_2D, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, WIDTH, HEIGHT, 0, gl.RED, gl.FLOAT, disparities());
  const around = textureOf(gl.TEXTURE_2D, gl.NEAREST);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, WIDTH, HEIGHT, 0, gl.RGBA, gl.FLOAT, surroundings(disparities(), [WIDTH, HEIGHT]));
  const quad = (/** @type {WebGLFramebuffer | null} */ frame, /** @type {number} */ across, /** @type {number} */ down) => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.viewport(0, 0, across, down);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  };
  const restored = (/** @type {number} */ reference) => {
    const at = layersOf(images, gl.SRGB8_ALPHA8, gl.RGBA, [reference]);
    const layers = gl.getParameter(gl.TEXTURE_BINDING_2D_ARRAY);
    const predictor = textureOf(gl.TEXTURE_2D, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, images[reference]);
    const difference = textureOf(gl.TEXTURE_2D, gl.NEAREST);
    const [{ program, at: uniform }, frame] = [programOf(gl, RESTORE), gl.createFramebuffer()];
    gl.useProgram(program);
    gl.uniform1i(uniform("reference"), predictor);
    gl.uniform1i(uniform("difference"), difference);
    gl.uniform1i(uniform("disparities"), known);
    gl.uniform2f(uniform("size"), WIDTH, HEIGHT);
    gl.uniform2fv(uniform("from"), content.views.cameras[reference]);
    images.forEach((image, k) => {
      if (k === reference) return;
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, layers, 0, k);
      gl.uniform2fv(uniform("camera"), content.views.cameras[k]);
      quad(frame, width, height);
    });
    return at;
  };
  const { reference } = content.views;
  const views = reference === null ? layersOf(images, gl.SRGB8_ALPHA8, gl.RGBA) : restored(reference);
  const mask = masks ? layersOf(masks, gl.R8, gl.RED) : views;
  const cameras = textureOf(gl.TEXTURE_2D, gl.NEAREST);
  const target = (/** @type {number} */ stored, /** @type {number} */ filter) => {
    const at = textureOf(gl.TEXTURE_2D, filter);
    gl.texStorage2D(gl.TEXTURE_2D, 1, stored, width, height);
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    const made = /** @type {WebGLTexture} */ (gl.getParameter(gl.TEXTURE_BINDING_2D));
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made, 0);
    return { at, frame };
  };
  const summed = target(gl.RGBA32F, gl.NEAREST);
  const blurred = target(gl.RGBA32F, gl.NEAREST);
  const picture = target(gl.RGBA8, gl.LINEAR);
  if (gl.getError() !== gl.NO_ERROR) return null; // its memory does not hold the views
  const scene = (/** @type {ReturnType<typeof programOf>} */ { at }, /** @type {Lens} */ lens) => {
    gl.uniform3f(at("focus"), lens.slope, lens.tiltX, lens.tiltY);
    gl.uniform2f(at("size"), WIDTH, HEIGHT);
  };

  let [across, down] = [width, height]; // pixels that are drawn
  let start = 0;
  /** @type {number | null} */
  let time = 0;
  /** @type {WebGLSync | null} */
  let fence = null;

  return {
    draw(lens, share = 1, fine = true) {
      [across, down, start, time] = [Math.ceil(share * width), Math.ceil(share * height), performance.now(), null];
      // Only cameras with weight are read: they come first.
      const used = cameraWeights(content.views.cameras, lens, REACH)
        .map((weight, k) => [...content.views.cameras[k], weight, k])
        .filter(([, , weight]) => weight > 0);
      gl.activeTexture(gl.TEXTURE0 + cameras);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, used.length, 1, 0, gl.RGBA, gl.FLOAT, new Float32Array(used.flat()));
      gl.useProgram(sum.program);
      scene(sum, lens);
      gl.uniform1i(sum.at("views"), views);
      gl.uniform1i(sum.at("masks"), mask);
      gl.uniform1i(sum.at("cameras"), cameras);
      gl.uniform1i(sum.at("n"), used.length);
      gl.uniform1i(sum.at("masked"), masks ? 1 : 0);
      gl.uniform1i(sum.at("fine"), fine ? 1 : 0);
      quad(summed.frame, across, down);
      gl.useProgram(box.program);
      scene(box, lens);
      gl.uniform1i(box.at("surroundings"), around);
      gl.uniform2f(box.at("viewpoint"), lens.x, lens.y);
      gl.uniform2i(box.at("pixels"), across, down);
      gl.uniform1f(box.at("cell"), Math.min(1, fittingAperture(lens, REACH)));
      for (const [from, to, axis, last] of /** @type {const} */ ([[summed, blurred, [1, 0], 0], [blurred, picture, [0, 1], 1]])) {
        gl.uniform1i(box.at("sum"), from.at);
        gl.uniform2i(box.at("axis"), axis[0], axis[1]);
        gl.uniform1i(box.at("last"), last);
        quad(to.frame, across, down);
      }
      if (fence) gl.deleteSync(fence);
      fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
      gl.flush();
    },
    took() {
      if (time === null && fence && gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.SIGNALED) time = performance.now() - start;
      return time;
    },
    show(placed) {
      gl.useProgram(show.program);
      gl.uniform1i(show.at("picture"), picture.at);
      gl.uniform4f(show.at("box"), placed.left, placed.top, placed.width, placed.height);
      gl.uniform2f(show.at("used"), across / width, down / height);
      gl.uniform2f(show.at("window"), canvas.width, canvas.height);
      quad(null, canvas.width, canvas.height);
    },
    pixels() {
      const read = new Uint8ClampedArray(4 * across * down);
      gl.bindFramebuffer(gl.FRAMEBUFFER, picture.frame);
      gl.readPixels(0, 0, across, down, gl.RGBA, gl.UNSIGNED_BYTE, read);
      return new ImageData(read, across, down);
    },
  };
}

const COARSE = 2; // pixels along the side of one without a graphics processor

/** Views, one after the other into the same canvas, from their differences. @param {ImageBitmap[]} images
 * @returns {Generator<ImageBitmap | OffscreenCanvas>} */
function* wholeViews(images) {
  const { reference, cameras, size: [height, width] } = content.views;
  const canvas = new OffscreenCanvas(width, height);
  const drawing = /** @type {OffscreenCanvasRenderingContext2D} */ (canvas.getContext("2d", { willReadFrequently: true }));
  const pixelsOf = (/** @type {ImageBitmap} */ image) => {
    drawing.drawImage(image, 0, 0);
    return drawing.getImageData(0, 0, width, height);
  };
  if (reference === null) return yield* images;
  const from = { pixels: pixelsOf(images[reference]).data, size: /** @type {Point} */ ([width, height]), camera: cameras[reference] };
  const known = { values: disparities(), size: /** @type {Point} */ ([WIDTH, HEIGHT]) };
  for (const [k, image] of images.entries()) {
    if (k === reference) yield image;
    else {
      const view = pixelsOf(image);
      addPrediction(view.data, from, cameras[k], known);
      drawing.putImageData(view, 0, 0);
      yield canvas;
    }
  }
}

/** The lens on the processor. @param {HTMLCanvasElement} canvas @param {ImageBitmap[]} images @returns {Drawing} */
function plainLens(canvas, images) {
  const [height, width] = content.views.size.map((/** @type {number} */ length) => Math.ceil(length / COARSE));
  const scratch = new OffscreenCanvas(width, height);
  const drawing = /** @type {OffscreenCanvasRenderingContext2D} */ (scratch.getContext("2d", { willReadFrequently: true }));
  const linear = Float32Array.from({ length: 256 }, (_, k) => {
    return k <= 10 ? k / 255 / 12.92 : ((k / 255 + 0.055) / 1.055) ** 2.4;
  });
  const views = Array.from(wholeViews(images), (image) => {
    drawing.drawImage(image, 0, 0, width, height);
    return drawing.getImageData(0, 0, width, height).data;
  });
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  let output = new ImageData(width, height);
  let time = 0;
  return {
    draw(lens, share = 1) {
      const start = performance.now();
      const [across, down] = [Math.ceil(share * width), Math.ceil(share * height)];
      const light = new Float32Array(4 * across * down);
      cameraWeights(content.views.cameras, lens, REACH).forEach((weight, k) => {
        if (weight > 0) addView({ light, across, down }, { view: views[k], width, height }, content.views.cameras[k], weight, lens, linear);
      });
      output = new ImageData(across, down);
      for (let p = 0; p < light.length; p += 4) {
        for (let c = 0; c < 3; c++) {
          const value = light[p + c] / Math.max(light[p + 3], 1e-6);
          output.data[p + c] = 255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055);
        }
        output.data[p + 3] = 255;
      }
      drawing.putImageData(output, 0, 0);
      time = performance.now() - start;
    },
    took: () => time,
    show(box) {
      context.fillRect(0, 0, canvas.width, canvas.height);
      context.drawImage(scratch, 0, 0, output.width, output.height, box.left, box.top, box.width, box.height);
    },
    pixels: () => output,
  };
}

/** Add a view to the weighted sum; of a smaller sum, every so many pixels of it.
 * @param {{ light: Float32Array, across: number, down: number }} sum @param {{ view: Uint8ClampedArray, width: number, height: number }} from
 * @param {Point} camera @param {number} weight @param {Lens} lens @param {Float32Array} linear */
function addView({ light, across, down }, { view, width, height }, [cx, cy], weight, lens, linear) {
  // Numbers alone in the inner loop: arrays would be millions.
  const [stepX, stepY, shiftX, shiftY] = [width / across, height / down, (cx * width) / WIDTH, (cy * height) / HEIGHT];
  for (let y = 0; y < down; y++) {
    const slopeOfRow = lens.slope + lens.tiltY * (y / down - 0.5) - 0.5 * lens.tiltX;
    for (let x = 0; x < across; x++) {
      const slope = slopeOfRow + (lens.tiltX * x) / across;
      const column = Math.round(x * stepX + slope * shiftX);
      const row = Math.round(y * stepY + slope * shiftY);
      if (column < 0 || row < 0 || column >= width || row >= height) continue;
      const source = 4 * (row * width + column);
      const target = 4 * (y * across + x);
      light[target] += weight * linear[view[source]];
      light[target + 1] += weight * linear[view[source + 1]];
      light[target + 2] += weight * linear[view[source + 2]];
      light[target + 3] += weight;
    }
  }
}

const REACH = reachOf(content.views.cameras);

/** @param {HTMLCanvasElement} canvas @returns {Promise<Drawing>} */
async function newLens(canvas) {
  const images = await Promise.all(content.views.pictures.map(decode));
  const masks = content.views.masks ? await Promise.all(content.views.masks.map(decode)) : null;
  const isPlain = new URLSearchParams(location.hash.slice(1)).has("plain");
  const drawing = isPlain ? null : glLens(canvas, images, masks);
  if (drawing) {
    canvas.dataset.by = "webgl";
    return drawing;
  }
  // A canvas of WebGL cannot become one of the processor.
  const plain = /** @type {HTMLCanvasElement} */ (canvas.cloneNode());
  plain.dataset.by = "canvas";
  canvas.replaceWith(plain);
  return plainLens(plain, images);
}
