// What holds for the page of fame view, and for its tests. Formatting is prettier's; types are tsc's.

import js from "@eslint/js";
import globals from "globals";

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
    },
  },
  { files: ["tests/page/*.mjs"], languageOptions: { globals: globals.node } },
];
