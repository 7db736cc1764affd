// Fails unless the Khronos validator finds neither errors nor warnings in the GLB file named on the command line.
const fs = require("fs");
const validator = require("gltf-validator");

validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2]))).then(({ issues }) => {
  console.log(`gltf-validator: ${issues.numErrors} errors, ${issues.numWarnings} warnings`);
  process.exit(issues.numErrors + issues.numWarnings > 0 ? 1 : 0);
});
