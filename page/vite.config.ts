import { defineConfig } from "vite";

// Fixed names and one script: the build is committed and compared with what the sources give.
export default defineConfig({
  base: "/static/",
  build: {
    outDir: "../src/mlsroad_pipeline/page/static",
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
