// The canvas: Spark draws the Gaussians as tg4mm's rasteriser does.
import { SparkRenderer } from "@sparkjsdev/spark";
import * as THREE from "three";
import { place, project } from "./camera.js";
import { MovingSplats } from "./splats.js";

const ALPHA_MIN = 1 / 255; // tg4mm/fit/rasterize/kernels/layout.py
const EPS_2D = 0.3; // pixels², added to every projected covariance, opacity unchanged

export class Stage {
  constructor(canvas, scene, data, onDirty, onError) {
    this.canvas = canvas;
    this.onError = onError;
    // Straight display values: no tone mapping, no conversion of colours (Spark draws into an sRGB canvas as is).
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: false, depth: false, stencil: false });
    this.renderer.setPixelRatio(1); // sizes are given in pixels of the screen
    this.renderer.toneMapping = THREE.NoToneMapping;
    this.setBackground(scene.background);
    this.camera = new THREE.PerspectiveCamera();
    this.world = new THREE.Scene();
    this.splats = new MovingSplats(scene, data);
    this.spark = new SparkRenderer({
      renderer: this.renderer,
      autoUpdate: false,
      accumExtSplats: true, // centres as float32: motion far below float16's steps
      enableLod: false,
      sortRadial: false,
      preBlurAmount: EPS_2D,
      blurAmount: 0,
      minAlpha: ALPHA_MIN,
      maxStdDev: Math.sqrt(-2 * Math.log(ALPHA_MIN)),
      maxPixelRadius: 4096,
      onDirty,
    });
    this.world.add(this.splats, this.spark);
    this.size = [0, 0];
  }

  setBackground(rgb) {
    this.renderer.setClearColor(new THREE.Color().setRGB(...rgb, THREE.SRGBColorSpace), 1);
  }

  resize(width, height) {
    if (this.size[0] === width && this.size[1] === height) return;
    this.size = [width, height];
    this.renderer.setSize(width, height, false);
  }

  /** The low-pass at `scale` pixels of the canvas for one of the capture: enlarged with the picture, not shrunk with it. */
  setScale(scale) {
    this.spark.preBlurAmount = EPS_2D * Math.max(1, scale) ** 2;
  }

  /** Move the Gaussians and draw them at once; their order may be that of the frame before. */
  draw({ time, alpha, band }) {
    this.splats.pose(time, alpha, band, this.camera);
    this.spark.update({ scene: this.world, camera: this.camera }).catch(this.onError);
    this.renderer.render(this.world, this.camera);
  }

  /** Move, sort and draw, and only then return: what is on the canvas is exact. */
  async drawSorted({ time, alpha, band }) {
    await this.settled();
    this.splats.pose(time, alpha, band, this.camera);
    await this.spark.update({ scene: this.world, camera: this.camera });
    await this.settled();
    this.renderer.render(this.world, this.camera);
  }

  async settled() {
    while (this.spark.sorting || this.spark.sortDirty) await new Promise((done) => setTimeout(done, 5));
  }

  /** A picture [PNG as a data URL] from a capture's camera, in its own size. */
  async picture(view, state) {
    const before = { size: this.size, matrix: this.camera.matrixWorld.clone() };
    const projection = this.camera.projectionMatrix.clone();
    const { fov } = this.camera;
    const low = this.spark.preBlurAmount;
    try {
      this.setScale(1);
      this.resize(view.width, view.height);
      place(this.camera, view.viewmat);
      project(this.camera, view, view.width, view.height);
      await this.drawSorted(state);
      return this.canvas.toDataURL("image/png");
    } finally {
      this.spark.preBlurAmount = low;
      this.resize(...before.size);
      before.matrix.decompose(this.camera.position, this.camera.quaternion, new THREE.Vector3());
      this.camera.updateMatrixWorld(true);
      this.camera.fov = fov;
      this.camera.projectionMatrix.copy(projection);
      this.camera.projectionMatrixInverse.copy(projection).invert();
    }
  }
}
