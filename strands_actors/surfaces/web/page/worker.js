/** Draws in a worker. The messages are calls of a `Drawing`, and the answer to `load`. */
import "/page/locale.js"
import {Drawing} from "/page/drawing.js"

let drawing = null

addEventListener("message", async ({data: {call, value}}) => {
  if (call === "open") {
    try { drawing = new Drawing(value.canvas, value.pixelRatio) }
    catch (problem) { postMessage({problem: problem.message}) }
  }
  else if (call === "load" && drawing) {
    try { postMessage({loaded: await drawing.load(value)}) }
    catch (problem) { postMessage({problem: problem.message}) }
  }
  else drawing?.[call](value)
})
