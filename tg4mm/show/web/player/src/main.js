// The page: reads its scene, plays it, and offers window.tg4mm to pages that embed it (docs/web.md).
import { Orbit, project } from "./camera.js";
import { Controls } from "./controls.js";
import { inflate, tables } from "./data.js";
import { Stage } from "./stage.js";
import { advanced, firstState, stateOfAddress, withState } from "./state.js";

const find = (id) => document.getElementById(id);
const SHARPEST = 2; // pixels of the canvas for one of the page: more costs time and shows nothing
const COARSEST = 0.5;
const SLOW_MS = 80; // a frame, mean over some: from there on fewer pixels are drawn

function say(text) {
  find("notice").textContent = text;
  find("notice").hidden = !text;
}

class Player {
  constructor(scene, data) {
    this.scene = scene;
    this.canvas = document.querySelector("canvas");
    this.stage = new Stage(this.canvas, scene, data, () => this.touch(), (error) => this.fail(error));
    this.state = withState(firstState(scene), stateOfAddress(location.hash));
    this.controls = new Controls(scene, (wanted) => this.set(wanted));
    this.touched = true;
    this.busy = 0; // pictures being made: the canvas is theirs
    this.sharpness = Math.min(devicePixelRatio || 1, SHARPEST);
    this.mean = 0; // milliseconds a frame takes while it plays
    this.open(scene.camera, scene.target_depth);
    this.listen();
    this.set({});
    requestAnimationFrame((now) => this.frame(now, now));
  }

  /** Look from a camera of the form of scene.camera, and orbit around the point `depth` before it. */
  open(view, depth) {
    this.view = view;
    this.orbit?.dispose();
    this.orbit = new Orbit(this.stage.camera, this.canvas, view, depth, () => this.touch());
    this.fit();
  }

  listen() {
    new ResizeObserver(() => this.fit()).observe(this.canvas.parentElement);
    find("play").addEventListener("click", () => this.set({ playing: !this.state.playing }));
    find("reset").addEventListener("click", () => this.open(this.scene.camera, this.scene.target_depth));
    find("ground").addEventListener("change", () => this.ground(Number(find("ground").value)));
    addEventListener("hashchange", () => this.set(stateOfAddress(location.hash)));
    addEventListener("keydown", (event) => {
      if (event.key !== " " || event.target.closest("button, input, select, summary")) return;
      event.preventDefault();
      this.set({ playing: !this.state.playing });
    });
    this.canvas.addEventListener("webglcontextlost", () => say("The browser has lost its graphics. Load the page again."));
  }

  ground(grey) {
    this.stage.setBackground([grey, grey, grey]);
    this.canvas.parentElement.style.background = `rgb(${grey * 255} ${grey * 255} ${grey * 255})`;
    this.touch();
  }

  fit() {
    if (this.busy) return;
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    const size = [clientWidth, clientHeight].map((n) => Math.max(1, Math.round(n * this.sharpness)));
    this.stage.resize(...size);
    this.stage.setScale(project(this.stage.camera, this.view, ...size));
    this.touch();
  }

  touch() {
    this.touched = true;
  }

  set(wanted) {
    const motion = this.scene.motion;
    this.state = withState(this.state, motion ? wanted : {});
    this.controls.show(this.state);
    this.touch();
  }

  frame(now, before) {
    if (this.state.playing && !this.busy) {
      this.state = advanced(this.state, this.scene.motion, Math.min(now - before, 250) / 1000);
      this.controls.showTime(this.state);
      this.touch();
      this.keepPace(now - before);
    }
    if (this.touched && !this.busy) {
      this.touched = false;
      this.stage.draw(this.state);
    }
    requestAnimationFrame((next) => this.frame(next, now));
  }

  /** Draw fewer pixels where frames take long; never more again, lest the picture goes to and fro. */
  keepPace(milliseconds) {
    this.mean += (Math.min(milliseconds, 1000) - this.mean) / 10;
    if (this.mean < SLOW_MS || this.sharpness <= COARSEST) return;
    this.sharpness = Math.max(COARSEST, this.sharpness * 0.7);
    this.mean = 0;
    this.fit();
  }

  fail(error) {
    say(`This scene cannot be drawn: ${error.message}`);
  }

  /** Pause and show alpha, band, time, camera as given; resolves when it is drawn, in exact order. */
  async show({ camera, ...wanted } = {}) {
    this.set({ playing: false, ...wanted });
    if (camera) this.open(camera, this.scene.target_depth);
    await this.alone(() => this.stage.drawSorted(this.state));
  }

  /** A picture, a PNG as a data URL, from `camera` in its own size; nothing on the page changes. */
  async picture({ camera = this.scene.camera, ...wanted } = {}) {
    const state = withState(this.state, wanted);
    return this.alone(() => this.stage.picture(camera, state));
  }

  /** Run `work` while nothing else draws, one after the other. */
  async alone(work) {
    this.busy++;
    const turn = (this.queue ?? Promise.resolve()).then(work);
    this.queue = turn.catch(() => {});
    try {
      return await turn;
    } finally {
      this.busy--;
      this.fit();
    }
  }
}

async function start() {
  const scene = JSON.parse(find("scene").textContent);
  if (!document.createElement("canvas").getContext("webgl2"))
    throw new Error("this browser has no WebGL 2 (or it is switched off), which draws the scene");
  if (typeof DecompressionStream === "undefined")
    throw new Error("this browser is older than 2023 and cannot unpack the scene");
  const bytes = await inflate(find("block").textContent.trim());
  const player = new Player(scene, tables(bytes, scene.layout));
  await player.alone(() => player.stage.drawSorted(player.state));
  say("");
  return {
    scene,
    show: (wanted) => player.show(wanted),
    picture: (wanted) => player.picture(wanted),
    play: () => player.set({ playing: true }),
    pause: () => player.set({ playing: false }),
    state: () => ({ ...player.state }),
  };
}

window.tg4mm = { ready: start() };
window.tg4mm.ready.then(
  (player) => Object.assign(window.tg4mm, player),
  (error) => say(`This scene cannot be played: ${error.message}.`),
);
