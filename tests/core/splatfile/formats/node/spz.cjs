// The reference library, as WebAssembly: prints the Gaussians of an .spz as JSON.
process.type = "renderer"; // built for browsers, it would otherwise look for parts of node that it does not find
const fs = require("fs");
const { loadSpz } = require("@spz-loader/core");

const options = { unpackOptions: { coordinateSystem: "UNSPECIFIED" } };
loadSpz(fs.readFileSync(process.argv[2]), options).then((cloud) => {
  const plain = Object.entries(cloud).map(([name, value]) => [name, value.length === undefined ? value : Array.from(value)]);
  console.log(JSON.stringify(Object.fromEntries(plain)));
});
