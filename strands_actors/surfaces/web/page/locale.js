/** A browser in the C locale names a language ("en-US@posix") that its own NumberFormat refuses, and uPlot asks for
 * it when it is loaded. So this module is imported before everything else. */
try {
  new Intl.NumberFormat(navigator.language)
} catch {
  Object.defineProperty(navigator, "language", {value: "en-US"})
}
