/** What a page shows of its stop. It stays after the connection is lost, since a missing answer is not a success. */
export class Stopping {
  constructor() {
    this.isPressed = false // pressed, and not answered yet
    this.text = ""
  }

  press(isOpen) {
    this.isPressed = true
    this.text = isOpen ? "sent" : ""
    this.look("", isOpen)
  }

  /** Take the server's result, which is empty if there is none. */
  look(result, isOpen) {
    if (isOpen && !result && !this.isPressed) this.text = ""
    if (result) { this.text = result; this.isPressed = false }
    if (this.text === "sent" && !isOpen) this.text = "NOT CONFIRMED: the connection ended. Cut its power if it still moves"
    else if (this.isPressed && !isOpen && !this.text)
      this.text = "NOT SENT: this page is not connected. Use the robot's own switch"
  }

  /** "stopping" until the robot has confirmed the stop, then "stopped". */
  get state() { return /^(NOT|sent|asked)/.test(this.text) ? "stopping" : "stopped" }
}
