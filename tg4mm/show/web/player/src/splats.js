// The Gaussians at a time, computed on the GPU: a generator for Spark, whose statements are GLSL.
import { SplatGenerator, dyno } from "@sparkjsdev/spark";
import * as THREE from "three";
import { coefficients, modeGains } from "./motion.js";

const LIGHT_LIMIT = 0.1; // tg4mm/fit/motion/appearance_modes.py, LIMIT
const SH_0 = 0.28209479177387814;
// Y_k of docs/conventions.md, k from 1.
const BASIS = `
  -0.4886025119029199 * d.y | 0.4886025119029199 * d.z | -0.4886025119029199 * d.x |
  1.0925484305920792 * d.x * d.y | -1.0925484305920792 * d.y * d.z |
  0.31539156525252005 * (2.0 * d.z * d.z - d.x * d.x - d.y * d.y) | -1.0925484305920792 * d.x * d.z |
  0.5462742152960396 * (d.x * d.x - d.y * d.y) | -0.5900435899266435 * d.y * (3.0 * d.x * d.x - d.y * d.y) |
  2.890611442640554 * d.x * d.y * d.z | -0.4570457994644658 * d.y * (4.0 * d.z * d.z - d.x * d.x - d.y * d.y) |
  0.3731763325901154 * d.z * (2.0 * d.z * d.z - 3.0 * d.x * d.x - 3.0 * d.y * d.y) |
  -0.4570457994644658 * d.x * (4.0 * d.z * d.z - d.x * d.x - d.y * d.y) |
  1.445305721320277 * d.z * (d.x * d.x - d.y * d.y) | -0.5900435899266435 * d.x * (d.x * d.x - 3.0 * d.y * d.y)`
  .split("|")
  .map((text) => text.trim());

function texture({ data, width, height, depth }, type) {
  const made = new THREE.DataArrayTexture(data, width, height, depth);
  made.format = THREE.RGBAFormat;
  made.type = type;
  made.needsUpdate = true;
  return made;
}

/** GLSL that reads `count` vec3 from value `first` on, [name_0, name_1 …]: the texels they lie in, then the vectors. */
function vectors(name, first, count) {
  const lines = [];
  const last = first + 3 * count - 1;
  const base = first >> 2;
  if (count) for (let p = base; p <= last >> 2; p++) lines.push(`vec4 ${name}_t${p} = value(index, ${p});`);
  const component = (v) => `${name}_t${v >> 2}.${"xyzw"[v & 3]}`;
  for (let j = 0; j < count; j++) {
    const v = first + 3 * j;
    lines.push(`vec3 ${name}_${j} = vec3(${component(v)}, ${component(v + 1)}, ${component(v + 2)});`);
  }
  return lines;
}

function motionLines(first, count) {
  const lines = ["vec3 shift = vec3(0.0), turn = vec3(0.0);", ...vectors("field", first, 2 * count)];
  for (let r = 0; r < count; r++) {
    lines.push(`shift += shifts[${r}] * field_${2 * r};`, `turn += turns[${r}] * field_${2 * r + 1};`);
  }
  return lines;
}

/** Changes of the first coefficients, drawn in to LIGHT_LIMIT by a tanh. */
function lightLines(first, lights, count) {
  if (!lights) return [];
  const lines = vectors("light", first, lights * count);
  for (let k = 0; k < count; k++) {
    const terms = Array.from({ length: lights }, (_, r) => `lights[${r}] * light_${r * count + k}`);
    lines.push(`vec3 change_${k} = ${terms.join(" + ")};`);
  }
  const squares = Array.from({ length: count }, (_, k) => `dot(change_${k}, change_${k})`).join(" + ");
  lines.push(`float size = sqrt(${squares}) * ${SH_0 / LIGHT_LIMIT};`, "float kept = tanh(size) / max(size, 1e-6);");
  for (let k = 0; k < count; k++) lines.push(`sh_${k} += kept * change_${k};`);
  return lines;
}

function statements(out, index, layout) {
  const { sh_count: shCount, n_fields: nFields, light_count: lightCount, n_lights: nLights } = layout;
  const shFirst = 7;
  const fieldFirst = shFirst + 3 * shCount;
  const colour = Array.from({ length: shCount - 1 }, (_, k) => `colour += (${BASIS[k]}) * sh_${k + 1};`);
  return [
    `{ int index = ${index};`,
    "vec4 exactly = texelFetch(exact, texel(index, 0), 0);",
    "vec4 first = value(index, 0), second = value(index, 1);",
    ...motionLines(fieldFirst, nFields),
    "vec3 centre = exactly.xyz + shift;",
    // exp(turn) · q: the turn, about the world's axes, comes after the Gaussian's own rotation
    "float angle = length(turn);",
    "vec4 turned = vec4(turn * (angle < 1e-6 ? 0.5 : sin(0.5 * angle) / angle), cos(0.5 * angle));",
    "vec4 rest = normalize(vec4(first.w, second.xyz));",
    ...vectors("sh", shFirst, shCount),
    ...lightLines(fieldFirst + 6 * nFields, nLights, lightCount),
    "vec3 d = normalize(centre - eye);",
    `vec3 colour = 0.5 + ${SH_0} * sh_0;`,
    ...colour,
    `${out}.flags = GSPLAT_FLAG_ACTIVE;`,
    `${out}.index = index;`,
    `${out}.center = centre;`,
    `${out}.scales = exp(first.xyz);`,
    `${out}.quaternion = quatQuat(turned, rest);`,
    `${out}.rgba = vec4(max(colour, 0.0), exactly.w); }`,
  ];
}

const globals = (layout) => [
  dyno.defineGsplat,
  "uniform highp sampler2DArray exact;\nuniform highp sampler2DArray values;\nuniform vec3 eye;",
  `uniform float shifts[${layout.n_fields || 1}];\nuniform float turns[${layout.n_fields || 1}];`,
  `uniform float lights[${layout.n_lights || 1}];`,
  "ivec3 texel(int i, int layer) { int w = textureSize(values, 0).x; return ivec3(i % w, i / w, layer); }",
  "vec4 value(int i, int layer) { return texelFetch(values, texel(i, layer), 0); }",
];

/** The scene's Gaussians as a node for Spark; `pose` sets where they are and from where they are looked at. */
export class MovingSplats extends SplatGenerator {
  constructor(scene, { exact, values }) {
    const { layout } = scene;
    const uniforms = {
      exact: { value: texture(exact, THREE.FloatType) },
      values: { value: texture(values, THREE.HalfFloatType) },
      eye: { value: new THREE.Vector3() },
      shifts: { value: new Array(layout.n_fields || 1).fill(0) },
      turns: { value: new Array(layout.n_fields || 1).fill(0) },
      lights: { value: new Array(layout.n_lights || 1).fill(0) },
    };
    const generator = dyno.dynoBlock({ index: "int" }, { gsplat: dyno.Gsplat }, ({ index }) => {
      const block = new dyno.Dyno({
        inTypes: { index: "int" },
        outTypes: { gsplat: dyno.Gsplat },
        inputs: { index },
        generate: ({ inputs, outputs }) => ({
          globals: globals(layout),
          statements: statements(outputs.gsplat, inputs.index, layout),
          uniforms,
        }),
      });
      return { gsplat: block.outputs.gsplat };
    });
    super({ numSplats: layout.n_gaussians, generator });
    this.scene = scene;
    this.uniforms = uniforms;
  }

  /** Timestep (fractions allowed), α, band [low, high] in Hz or null, and the camera. */
  pose(time, alpha, band, camera) {
    const { motion } = this.scene;
    this.uniforms.eye.value.setFromMatrixPosition(camera.matrixWorld);
    if (motion) {
      const gains = modeGains(motion, time, alpha, band);
      coefficients(motion.series, gains).forEach((c, r) => {
        this.uniforms.shifts.value[r] = c * motion.sizes[r][0];
        this.uniforms.turns.value[r] = c * motion.sizes[r][1];
      });
      if (motion.light_series) this.uniforms.lights.value = coefficients(motion.light_series, gains);
    }
    this.updateVersion();
  }
}
