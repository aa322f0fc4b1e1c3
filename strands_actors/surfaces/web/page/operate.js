import {el, number, setText} from "/page/dom.js"
import {Gamepads} from "/page/gamepad.js"
import {Hand} from "/page/hand.js"
import {Stopping} from "/page/stopping.js"

/** The page of one operator: it moves one robot, stops it, and has the recorder's buttons. */
const AGAIN_MS = 1000
const facts = JSON.parse(document.body.dataset.facts)
const element = id => document.getElementById(id)
const values = {}
const stopping = new Stopping()
let socket = null, isOpen = false, whyGone = ""
let key = "", isRunning = false, hasRecorder = false // of the recorder: the pressed key, whether it records, whether it is there

// -- the recorder

function press(word) {
  if (hasRecorder && isOpen) key = word === "toggle" ? (isRunning ? "finish" : "start") : word
}

function showEpisode(now) {
  hasRecorder = Boolean(now)
  isRunning = hasRecorder && now.running
  element("episode").hidden = !hasRecorder
  element("episode").className = isRunning ? "running" : ""
  setText(element("episode").querySelector("b"), hasRecorder ? now.text : "")
  setText(element("episode").querySelector("p"), hasRecorder ? now.last_event : "")
  setText(element("start"), isRunning ? "finish" : "start")
  element("discard").disabled = !isRunning
}

// -- the hand, and the stop

const hand = new Hand(send, true)
hand.pads = new Gamepads(facts.axes, facts.tool, press)

function send(held, rates) {
  if (!isOpen || (socket.bufferedAmount >= 1000 && !stopping.isPressed)) return
  const stop = stopping.isPressed
  socket.send(JSON.stringify({held: held && !stop, rates, at_ms: performance.now(), episode: key, stop}))
  key = ""
}

function pressStop() {
  stopping.press(isOpen)
  hand.release()
  showStop()
}

function showStop() {
  if (stopping.text) show(stopping.state, stopping.text)
  element("stop").classList.toggle("pressed", stopping.isPressed)
}

function show(state, why) {
  element("state").className = state
  setText(element("state").querySelector("b"), state)
  setText(element("state").querySelector("span"), why)
}

// -- the connection

function connect() {
  // A hidden page sends nothing, and would block other operators.
  if (document.hidden) { setTimeout(connect, AGAIN_MS); return }
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/operate`)
  socket.onopen = () => { isOpen = true }
  socket.onmessage = event => {
    const now = JSON.parse(event.data)
    show(now.state, now.why)
    whyGone = now.state === "gone" ? now.why : ""
    stopping.look(now.stopped, true)
    showStop()
    showEpisode(now.episode)
    setText(element("pad"), hand.pads.text)
    for (const axis in now.position) if (values[axis]) setText(values[axis], number(now.position[axis], axis.startsWith("ee.") ? 3 : 1))
  }
  socket.onclose = () => {
    isOpen = false
    key = ""
    hand.release()
    showEpisode(null)
    show("gone", whyGone || "not connected: the teleoperation has ended, or the network is lost")
    stopping.look("", false)
    showStop()
    setTimeout(connect, AGAIN_MS)
  }
}

document.title = facts.title
setText(element("title"), facts.title)
for (const axis of [...facts.axes, ...facts.tool]) {
  values[axis] = el("td", {class: "value"})
  element("axes").append(el("tr", {}, el("td", {}, hand.button(axis, -1)), el("th", {scope: "row"}, axis), values[axis],
    el("td", {}, hand.button(axis, 1))))
}
element("hand").hidden = facts.axes.length === 0
element("tools").hidden = facts.tool.length === 0
element("speed").oninput = event => { hand.speed = Number(event.target.value) }
element("stop").onpointerdown = event => { event.preventDefault(); pressStop() }
element("stop").onclick = event => { if (event.detail === 0) pressStop() } // detail 0: a click by the keyboard
addEventListener("keydown", event => {
  if (event.code !== "Space" || event.repeat) return
  event.preventDefault()
  pressStop()
}, {capture: true})
for (const [id, word] of [["start", "toggle"], ["discard", "discard"], ["again", "again"]]) {
  element(id).onpointerdown = () => press(word)
  element(id).onclick = event => { if (event.detail === 0) press(word) }
}
connect()
