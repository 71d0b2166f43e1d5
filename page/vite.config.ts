import { createHash } from "node:crypto";
import { readdirSync, readFileSync } from "node:fs";

import { defineConfig, type Plugin } from "vite";

const NAMES = ["index.html", "package-lock.json", "tsconfig.json", "vite.config.ts"];

/** Digest of the sources: names and contents in order. The tests compare it with the sources without Node. */
function sourceDigest(): string {
  const digest = createHash("sha256");
  const files = [...NAMES, ...readdirSync(`${__dirname}/src`).map((name) => `src/${name}`)].sort();
  for (const name of files) digest.update(`${name}\n`).update(readFileSync(`${__dirname}/${name}`)).update("\n");
  return digest.digest("hex");
}

const facts: Plugin = {
  name: "facts",
  generateBundle() {
    const licence = readFileSync(`${__dirname}/node_modules/three/LICENSE`, "utf-8");
    const { version } = JSON.parse(readFileSync(`${__dirname}/node_modules/three/package.json`, "utf-8"));
    this.emitFile({ type: "asset", fileName: "sources.sha256", source: `${sourceDigest()}\n` });
    this.emitFile({
      type: "asset",
      fileName: "NOTICE.txt",
      source: `page.js contains three.js ${version} (https://threejs.org), used under this licence:\n\n${licence.trimEnd()}\n`,
    });
  },
};

// Fixed names and one script: the build is committed and compared with what the sources give.
export default defineConfig({
  base: "/static/",
  plugins: [facts],
  build: {
    outDir: "../src/mlsroad_pipeline/review/page_server/static",
    emptyOutDir: true,
    modulePreload: false,
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 2000,
    target: "es2022",
    rollupOptions: {
      output: {
        codeSplitting: false,
        entryFileNames: "page.js",
        assetFileNames: "page.[ext]",
      },
    },
  },
});
