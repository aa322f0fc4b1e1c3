/** Make an element. Texts are set as text, never as HTML. */
export function el(tag, attributes = {}, ...children) {
  const one = document.createElement(tag)
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) one.addEventListener(name.slice(2), value)
    else if (name === "class") one.className = value
    else if (value === true) one.setAttribute(name, "")
    else if (value !== false && value != null) one.setAttribute(name, value)
  }
  one.append(...children.flat(Infinity).filter(child => child != null && child !== false))
  return one
}

/** Set the text of an element, and leave it alone if it has this text already. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text
}

export const number = (value, digits = 1) =>
  value == null || !Number.isFinite(value) ? "–" : value.toFixed(digits).replace("-", "−")

export function since(seconds) {
  if (seconds < 0) return "–"
  if (seconds < 1) return `${Math.round(seconds * 1000)} ms`
  return seconds < 120 ? `${seconds.toFixed(1)} s` : `${Math.round(seconds / 60)} min`
}

/** The kind of a robot's state, which decides its colour. */
export function kindOf(robot) {
  if (robot.silent_s > 2) return "gone"
  if (robot.locked_by) return "locked"
  if (["unconfirmed", "lost"].includes(robot.state)) return "bad"
  if (["holding", "stopping"].includes(robot.state)) return "hold"
  return robot.state === "armed" ? "armed" : "off"
}

export function stateText(robot) {
  if (robot.silent_s > 2) return `unreachable for ${since(robot.silent_s)}`
  return robot.locked_by ? `e-stop by ${robot.locked_by}` : robot.state || "starting"
}
