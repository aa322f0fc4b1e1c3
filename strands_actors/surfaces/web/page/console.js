import "/page/locale.js"
import {Agent} from "/page/agent.js"
import {Consents} from "/page/consent.js"
import {Devices} from "/page/devices.js"
import {el, setText} from "/page/dom.js"
import {Fleet} from "/page/fleet.js"
import {Recordings} from "/page/recordings.js"
import {RobotView} from "/page/robot.js"
import {SetUp} from "/page/setup.js"

/** The views beside the fleet and the robots, by their place in the address. They are for operators. */
const VIEWS = {devices: Devices, recordings: Recordings, agent: Agent, setup: SetUp}
const AGAIN_MS = 1000
const NOTE_MS = 9000
const facts = JSON.parse(document.body.dataset.facts)
const mayCommand = facts.role === "operator"
const element = id => document.getElementById(id)

let socket = null, view = null, robots = [], shown = ""

// -- orders: each answer is shown, and no answer is never a success

function note(text, isGood) {
  const one = el("p", {class: isGood ? "good" : "bad"}, text)
  element("notes").prepend(one)
  setTimeout(() => one.remove(), NOTE_MS)
}

async function ask(path, options, what) {
  try {
    const answer = await fetch(path, options)
    if (answer.ok) return await answer.json()
    note(`${what}: ${await answer.text()}`, false)
  } catch (problem) {
    note(`${what}: NO ANSWER (${problem.message}). Look at the robot`, false)
  }
  return null
}

const orders = {
  get: path => ask(path, {}, path),
  post: (path, body = {}) => ask(path, {method: "POST", body: JSON.stringify(body), keepalive: true}, path),
  async stop(robot) { stopped(robot, await orders.post(`/robots/${robot}/stop`)) },
  async estop(robot) { stopped(robot, await orders.post(`/robots/${robot}/estop`)) },
  async resume(robot) {
    const locked = robots.find(each => each.name === robot)?.locked_by
    const lift = locked ? `Lift the e-stop by ${locked}, and energise` : "Energise"
    if (!await confirm(`${lift} ${robot} at its measured position? It starts no motion.`)) return
    told(`${robot} resume`, await orders.post(`/robots/${robot}/resume`), "armed")
  },
  async policy(robot, body) { told(`${robot} policy`, await orders.post(`/robots/${robot}/policy`, body), "started") },
  async pose(robot, name, targets) { told(`${robot} to ${name}`, await orders.post(`/robots/${robot}/pose`, {targets}), "on its way") },
  jog(message) { send({type: "jog", ...message}) },
  tool() { send({type: "tool"}) },
}

function stopped(robot, answer) {
  if (!answer) return
  const {outcome, safe_state, detail, took_ms} = answer.outcome
  note(answer.ok ? `${robot}: ${safe_state}, ${took_ms.toFixed(0)} ms` : `${robot}: ${outcome.toUpperCase()}. ${detail}`, answer.ok)
}

function told(what, answer, done) {
  if (answer) note(answer.ok ? `${what}: ${done}` : `${what}: ${answer.refused.text}`, answer.ok)
}

function confirm(question) {
  const dialog = element("ask")
  dialog.querySelector("p").textContent = question
  dialog.returnValue = "no"
  dialog.showModal()
  return new Promise(done => dialog.addEventListener("close", () => done(dialog.returnValue === "yes"), {once: true}))
}

// -- the connection

function send(message) {
  if (socket?.readyState === WebSocket.OPEN && socket.bufferedAmount < 4000) socket.send(JSON.stringify(message))
}

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`)
  socket.onopen = () => { link("connected", true); watch() }
  socket.onmessage = event => receive(JSON.parse(event.data))
  socket.onclose = event => {
    link(event.reason || "not connected. What you see is old", false)
    setTimeout(connect, AGAIN_MS)
  }
}

function link(text, isGood) {
  setText(element("link"), text)
  element("link").className = isGood ? "good" : "bad"
  document.body.classList.toggle("cut", !isGood)
}

function watch() {
  send({type: "watch", robot: shown})
  if (shown) orders.jog({held: false, at_ms: performance.now(), rates: {}})
}

function receive(message) {
  for (const feed of feeds) feed.receive(message)
  const ours = view instanceof RobotView && view
  if (message.type === "fleet") {
    robots = message.robots
    if (view instanceof Fleet) view.show(robots)
    const one = ours && robots.find(robot => robot.name === view.name)
    if (one) view.summary(one)
    return
  }
  if (!ours || (message.robot ?? message.reading?.robot) !== view.name) return
  if (message.type === "axes") view.setAxes(message.axes, message.reason)
  if (message.type === "tool") {
    view.setTool(message.keys)
    if (!message.keys.length) note(`${view.name} has no arm whose tool can be jogged here`, false)
  }
  if (message.type === "facts") view.setFacts(message.topics)
  if (message.type === "reading") view.reading(message.reading)
  if (message.type === "events") view.happened(message.events)
  if (message.type === "seat") view.seated(message.state, message.reason)
  for (const panel of view.panels) panel.receive?.(message)
}

// -- views

/** What every view shows beside itself. Each gets all messages. */
const feeds = [new Consents(element("consents"), orders, mayCommand), Agent]

function route() {
  const [, place, name] = location.hash.split("/")
  view?.close?.()
  shown = place === "robots" && name ? decodeURIComponent(name) : ""
  if (shown) view = new RobotView(shown, orders, mayCommand)
  else if (place in VIEWS && mayCommand) view = new VIEWS[place](orders)
  else { view = new Fleet(orders); view.show(robots) }
  element("view").replaceChildren(view.root)
  document.title = shown || "robots"
  for (const each of document.querySelectorAll("nav a"))
    each.toggleAttribute("aria-current", each.hash === (location.hash || "#/"))
  watch()
}

addEventListener("hashchange", route)
addEventListener("keydown", event => {
  if (event.code !== "Space" || event.target.matches("input:not([type=radio]), textarea")) return
  event.preventDefault()
  if (event.repeat) return
  for (const name of shown ? [shown] : robots.map(robot => robot.name)) orders.stop(name)
}, {capture: true})

const theme = localStorage.getItem("theme")
if (theme) document.documentElement.dataset.theme = theme
element("theme").onclick = () => {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches
  const now = document.documentElement.dataset.theme || (dark ? "dark" : "light")
  localStorage.setItem("theme", document.documentElement.dataset.theme = now === "dark" ? "light" : "dark")
}
for (const each of document.querySelectorAll("nav a.operator")) each.hidden = !mayCommand
document.querySelector("nav a.agent").hidden = !(mayCommand && facts.agent)
element("estop").src = facts.estop
route()
connect()
