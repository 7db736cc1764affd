import { defineConfig } from "vitest/config";

// Relative addresses: the page is served at a server's root and from any folder of a web host.
export default defineConfig({
  base: "./",
  build: {
    outDir: "neuroanimator_studio/page",
    emptyOutDir: true,
    target: "es2022",
    // An inlined asset would be a data: address, which the page's content security policy refuses.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1500,
  },
  test: { include: ["tests/**/*.test.ts"], testTimeout: 30_000 },
});
