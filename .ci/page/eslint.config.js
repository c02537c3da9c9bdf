// What holds for the page of fame view, and for its tests. Formatting is prettier's; types are tsc's.

import js from "@eslint/js";
import globals from "globals";

// A page that is a file has no server, and in a sandbox it keeps nothing.
const GUARDED = [
  ...["fetch", "WebSocket", "XMLHttpRequest"].map((name) => ({ name, message: "The data come by source.js." })),
  ...["localStorage", "sessionStorage"].map((name) => ({ name, message: "Use `keep` and `kept` of dom.js." })),
];

export default [
  js.configs.recommended,
  {
    languageOptions: { ecmaVersion: 2024, sourceType: "module", globals: globals.browser },
    rules: {
      "max-len": ["error", { code: 120 }],
      "max-lines-per-function": ["error", { max: 30, skipComments: true }],
      "one-var": ["error", "never"],
      "prefer-const": "error",
      "no-var": "error",
      eqeqeq: "error",
      "no-restricted-globals": ["error", ...GUARDED],
    },
  },
  { files: ["**/source.js"], rules: { "no-restricted-globals": "off" } },
  { files: ["tests/page/*.mjs"], languageOptions: { globals: globals.node } },
];
