// prototype
import { inflate, tables } from "./data.js";
import { Stage } from "./stage.js";
(async () => {
  const scene = JSON.parse(document.getElementById("scene").textContent);
  const bytes = await inflate(document.getElementById("block").textContent.trim());
  const stage = new Stage(document.querySelector("canvas"), scene, tables(bytes, scene.layout), () => {});
  window.tg4mm = {picture: (o) => stage.picture(o.camera, o), stage, scene};
})();
