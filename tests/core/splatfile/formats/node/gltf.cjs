// Khronos's validator: prints its messages on a .glb as JSON.
const fs = require("fs");
const validator = require("gltf-validator");

const bytes = new Uint8Array(fs.readFileSync(process.argv[2]));
validator.validateBytes(bytes, { maxIssues: 0 }).then((report) => console.log(JSON.stringify(report.issues.messages)));
