// Shift-and-sum in linear light through any aperture, from any viewpoint, focused on any plane, tilted ones too: on the
// graphics processor, or, where there is none, on the processor at half the resolution.

const MOST = 256; // views
const VERTICES = `#version 300 es
in vec2 corner; out vec2 at;
void main() { at = vec2(0.5, -0.5) * corner + 0.5; gl_Position = vec4(corner, 0.0, 1.0); }`;
const PIXELS = `#version 300 es
precision highp float; precision highp sampler2DArray;
uniform sampler2DArray views; uniform sampler2D cameras; uniform int n; uniform vec3 focus; uniform vec2 size;
in vec2 at; out vec4 shown;
void main() {
  float slope = focus.x + dot(focus.yz, at - 0.5);
  vec3 light = vec3(0.0); float weight = 0.0;
  for (int k = 0; k < ${MOST}; k++) {
    if (k >= n) break;
    vec4 camera = texelFetch(cameras, ivec2(k, 0), 0);
    vec2 place = at + slope * camera.xy / size;
    if (camera.z <= 0.0 || any(lessThan(place, vec2(0.0))) || any(greaterThan(place, vec2(1.0)))) continue;
    light += camera.z * texture(views, vec3(place, float(k))).rgb; weight += camera.z;
  }
  light /= max(weight, 1e-6);
  shown = vec4(mix(12.92 * light, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, light)), 1.0);
}`;

// Distance of a camera from the middle of the aperture, in view steps, in the norm of the aperture's shape.
const SHAPES = {
  square: (x, y) => Math.max(Math.abs(x), Math.abs(y)),
  disc: (x, y) => Math.hypot(x, y),
  hexagon: (x, y) => Math.max(Math.abs(x), 0.5 * Math.abs(x) + 0.866 * Math.abs(y)),
};

function weights(settings) {
  const distance = SHAPES[settings.shape];
  return content.views.cameras.map(([x, y]) => {
    const [dx, dy] = [x - settings.across, y - settings.down];
    if (settings.aperture === 0) return Math.max(0, 1 - Math.abs(dx)) * Math.max(0, 1 - Math.abs(dy));
    return Math.min(1, Math.max(0, settings.aperture / 2 + 1 - distance(dx, dy)));
  });
}

function compiled(gl, kind, text) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, text);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  return shader;
}

function glLens(canvas, images) {
  const gl = canvas.getContext("webgl2", { preserveDrawingBuffer: true, antialias: false });
  if (!gl || !gl.getExtension("EXT_color_buffer_float") || images.length > MOST) return null;
  const [height, width] = content.views.size;
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTICES], [gl.FRAGMENT_SHADER, PIXELS]]) {
    gl.attachShader(program, compiled(gl, kind, text));
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.bindAttribLocation(program, 0, "corner");
  gl.vertexAttribPointer(gl.getAttribLocation(program, "corner"), 2, gl.FLOAT, false, 0, 0);
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D_ARRAY, gl.createTexture());
  gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.SRGB8_ALPHA8, width, height, images.length);
  images.forEach((image, k) => {
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, k, width, height, 1, gl.RGBA, gl.UNSIGNED_BYTE, image);
  });
  for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, side, gl.CLAMP_TO_EDGE);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, filter, gl.LINEAR);
  gl.activeTexture(gl.TEXTURE1);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
  const uniform = (name) => gl.getUniformLocation(program, name);
  gl.uniform1i(uniform("views"), 0);
  gl.uniform1i(uniform("cameras"), 1);
  gl.uniform1i(uniform("n"), images.length);
  gl.uniform2f(uniform("size"), WIDTH, HEIGHT);
  const focus = uniform("focus");
  return (settings) => {
    const cameras = weights(settings).flatMap((weight, k) => [...content.views.cameras[k], weight, 0]);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, images.length, 1, 0, gl.RGBA, gl.FLOAT, new Float32Array(cameras));
    gl.uniform3f(focus, settings.slope, settings.tiltAcross, settings.tiltDown);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  };
}

const COARSE = 2; // pixels along the side of one without a graphics processor

function plainLens(canvas, images) {
  const [height, width] = content.views.size.map((length) => Math.ceil(length / COARSE));
  [canvas.width, canvas.height] = [width, height];
  const scratch = document.createElement("canvas");
  [scratch.width, scratch.height] = [width, height];
  const reading = scratch.getContext("2d", { willReadFrequently: true });
  const linear = Float32Array.from({ length: 256 }, (_, k) => {
    return k <= 10 ? k / 255 / 12.92 : ((k / 255 + 0.055) / 1.055) ** 2.4;
  });
  const views = images.map((image) => {
    reading.drawImage(image, 0, 0, width, height);
    return reading.getImageData(0, 0, width, height).data;
  });
  const context = canvas.getContext("2d");
  return (settings) => {
    const output = context.createImageData(width, height);
    const light = new Float32Array(4 * width * height);
    weights(settings).forEach((weight, k) => {
      if (weight > 0) add(light, views[k], content.views.cameras[k], weight, settings, width, height, linear);
    });
    for (let p = 0; p < light.length; p += 4) {
      for (let c = 0; c < 3; c++) {
        const value = light[p + c] / Math.max(light[p + 3], 1e-6);
        output.data[p + c] = 255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055);
      }
      output.data[p + 3] = 255;
    }
    context.putImageData(output, 0, 0);
  };
}

function add(light, view, [cx, cy], weight, settings, width, height, linear) {
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const slope = settings.slope + settings.tiltAcross * (x / width - 0.5) + settings.tiltDown * (y / height - 0.5);
      const column = Math.round(x + (slope * cx * width) / WIDTH);
      const row = Math.round(y + (slope * cy * height) / HEIGHT);
      if (column < 0 || row < 0 || column >= width || row >= height) continue;
      const [from, to] = [4 * (row * width + column), 4 * (y * width + x)];
      for (let c = 0; c < 3; c++) light[to + c] += weight * linear[view[from + c]];
      light[to + 3] += weight;
    }
  }
}

async function newLens(canvas) {
  const images = await Promise.all(content.views.pictures.map(decode));
  [canvas.height, canvas.width] = content.views.size;
  const isPlain = new URLSearchParams(location.hash.slice(1)).has("plain");
  const draw = isPlain ? null : glLens(canvas, images);
  canvas.dataset.by = draw ? "webgl" : "canvas";
  return draw || plainLens(canvas, images);
}
