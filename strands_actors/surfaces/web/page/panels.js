import {RecorderPanel} from "/page/recorder.js"
import {ActorTree} from "/page/tree.js"

/** The further sections of a robot's view, in their order. Each is a class in a file of its own.
 *
 * It is made with (name, orders, mayCommand), and has `root`, its element. It may have
 * `summary(robot)`, which gets the robot's line of the fleet, `receive(message)`, which gets each
 * message of the server about this robot, `recorderKey(word)`, which gets the recorder's buttons of a gamepad
 * (`toggle`, `discard`), and `close()`. */
export const PANELS = [RecorderPanel, ActorTree]
