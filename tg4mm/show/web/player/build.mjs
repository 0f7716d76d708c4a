// Makes dist/player.js (one minified script), dist/licences.txt and dist/sources.json: npm ci && npm run build
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const PACKAGES = ["@sparkjsdev/spark", "three", "fflate"];

// The library's own download of its program for levels of detail looks at this page's address; in one script there is none.
const result = await build({
  entryPoints: ["src/main.js"],
  bundle: true,
  minify: true,
  format: "iife",
  target: ["es2022"],
  charset: "ascii",
  legalComments: "none",
  define: { "import.meta.url": '"about:blank"' },
  write: false,
});
rmSync("dist", { recursive: true, force: true });
mkdirSync("dist");
writeFileSync("dist/player.js", result.outputFiles[0].contents);

const licences = PACKAGES.map((name) => {
  const folder = `node_modules/${name}`;
  const { version } = JSON.parse(readFileSync(`${folder}/package.json`, "utf8"));
  return `${name} ${version}\n\n${readFileSync(`${folder}/LICENSE`, "utf8").trim()}\n`;
});
writeFileSync("dist/licences.txt", licences.join("\n----\n\n"));

// What the bundle was made of, so that a test can tell when it is older than its sources.
const sources = ["build.mjs", "package.json", "package-lock.json", ...readdirSync("src").map((name) => `src/${name}`)];
const sha256 = (path) => createHash("sha256").update(readFileSync(path)).digest("hex");
const made = Object.fromEntries([...sources.sort(), "dist/player.js"].map((path) => [path, sha256(path)]));
writeFileSync("dist/sources.json", `${JSON.stringify(made, null, 2)}\n`);
