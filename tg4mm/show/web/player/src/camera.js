// Cameras: those of a capture (docs/conventions.md) as three.js has them, and orbiting by mouse and touch.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

// By how far what is looked at is: near as tg4mm's rasteriser has it.
const NEAR = 1 / 400;
const FAR = 2.5e4;

/** Set the projection of a pinhole [K in pixels of w×h] in a window of width×height that shows all of its picture; returns its scale. */
export function project(camera, { K, width: w, height: h }, width, height) {
  const s = Math.min(width / w, height / h);
  const fx = s * K[0][0];
  const fy = s * K[1][1];
  const cx = width / 2 + s * (K[0][2] - w / 2);
  const cy = height / 2 + s * (K[1][2] - h / 2);
  const distance = camera.userData.distance ?? 4;
  const near = NEAR * distance;
  const far = FAR * distance;
  const a = -(far + near) / (far - near);
  const b = (-2 * far * near) / (far - near);
  camera.fov = (2 * Math.atan(height / (2 * fy)) * 180) / Math.PI; // OrbitControls pans by it
  camera.near = near;
  camera.far = far;
  // prettier-ignore
  camera.projectionMatrix.set(
    (2 * fx) / width, 0, 1 - (2 * cx) / width, 0,
    0, (2 * fy) / height, (2 * cy) / height - 1, 0,
    0, 0, a, b,
    0, 0, -1, 0,
  );
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  return s;
}

/** Put the camera where world-to-camera `viewmat` (OpenCV axes) says. */
export function place(camera, viewmat) {
  const toWorld = new THREE.Matrix4().set(...viewmat.flat()).invert();
  toWorld.multiply(new THREE.Matrix4().makeScale(1, -1, -1)); // OpenGL axes: y up, looking along −z
  toWorld.decompose(camera.position, camera.quaternion, new THREE.Vector3());
  camera.updateMatrixWorld(true);
}

/** Orbit controls that begin at `start` exactly, tilted cameras included. */
export class Orbit {
  constructor(camera, element, start, depth, onChange) {
    this.camera = camera;
    camera.userData.distance = depth;
    place(camera, start.viewmat);
    const [right, down, forward] = start.viewmat.slice(0, 3).map((row) => new THREE.Vector3(...row));
    // The world's up, less its part across the picture: the camera's own tilt then stays as it is.
    const up = new THREE.Vector3(0, 0, 1).addScaledVector(right, -right.z);
    if (up.length() < 0.1) up.copy(down).negate();
    camera.up.copy(up.normalize());
    this.controls = new OrbitControls(camera, element);
    this.controls.target.copy(camera.position).addScaledVector(forward, depth);
    this.controls.minDistance = depth / 50;
    this.controls.maxDistance = depth * 20;
    this.controls.enableDamping = false;
    this.controls.screenSpacePanning = true;
    this.controls.update();
    this.controls.addEventListener("change", onChange);
  }

  dispose() {
    this.controls.dispose();
  }
}
