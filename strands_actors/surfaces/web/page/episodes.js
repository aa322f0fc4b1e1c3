import {el, number} from "/page/dom.js"

const THUMB = [240, 90]
const COLOURS = ["#0ea5a4", "#3b82f6", "#d97706", "#a855f7", "#ef4444", "#84cc16", "#ec4899", "#64748b"]

/** An episode in a list: its first picture, or its joints over time without a camera, its length and its task. */
export function episodeCard(dataset, episode) {
  const path = `/recordings/${dataset}/episodes/${episode.number}`
  const [camera] = episode.cameras
  const picture = camera
    ? el("img", {src: `${path}/pictures/${camera}`, alt: `first picture of ${camera}`, loading: "lazy"})
    : jointsPicture(path)
  return el("li", {}, el("a", {href: `#/recordings/${dataset}/${episode.number}`}, picture,
    el("b", {}, `episode ${episode.number}`), ` ${number(episode.seconds)} s, ${episode.frames} frames`,
    el("small", {}, episode.task), episode.defects && el("small", {class: "bad"}, episode.defects)))
}

function jointsPicture(path) {
  const canvas = el("canvas", {width: THUMB[0], height: THUMB[1], role: "img", "aria-label": "the joints over time"})
  fetch(path).then(answer => answer.ok && answer.json()).then(track => track && drawJoints(canvas, track)).catch(() => {})
  return canvas
}

/** Draw each joint over time, in its own range. */
export function drawJoints(canvas, track) {
  const context = canvas.getContext("2d"), {width, height} = canvas
  const step = Math.max(1, Math.floor(track.times.length / width)), last = track.times.at(-1) || 1
  context.clearRect(0, 0, width, height)
  track.joints.forEach((_, joint) => {
    const values = track.measured.map(row => row[joint]).filter(value => value != null)
    const low = Math.min(...values.filter((_, at) => at % step === 0)), high = Math.max(...values.filter((_, at) => at % step === 0))
    context.strokeStyle = COLOURS[joint % COLOURS.length]
    context.lineWidth = 1.5
    context.beginPath()
    for (let at = 0; at < track.times.length; at += step) {
      const value = track.measured[at][joint]
      if (value == null) continue
      const y = height - 6 - (high > low ? (value - low) / (high - low) : 0.5) * (height - 12)
      context.lineTo(track.times[at] / last * width, y)
    }
    context.stroke()
  })
}
