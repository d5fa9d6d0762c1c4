// SPDX-License-Identifier: Apache-2.0
// Checks the types of the page of `redrive view`, which esbuild only strips:
//   node page_types_test.mjs PAGE NODE_MODULES
// Exit code 77: skipped, there is no TypeScript.
import {spawnSync} from "node:child_process";
import fs from "node:fs";
import path from "node:path";

const [page, modules] = process.argv.slice(2);
const compiler = path.join(modules, "typescript/lib/tsc.js");
if (!fs.existsSync(compiler)) {
  console.log("skipped: npm could not install TypeScript when this was built");
  process.exit(77);
}
process.exit(
  spawnSync(process.execPath, [compiler, "-p", page], {stdio: "inherit"}).status ?? 1);
