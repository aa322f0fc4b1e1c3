// roslib of npm: drive forwards for a second and stop. Arguments: the folder of modules, and the address.
import { pathToFileURL } from "node:url";

const [modules, address] = process.argv.slice(2);
const { Ros, Topic } = await import(pathToFileURL(`${modules}/roslib/dist/RosLib.js`));

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const ros = new Ros();
await ros.connect(`ws://${address}`);
const drive = new Topic({ ros, name: "/cmd_vel", messageType: "geometry_msgs/Twist" });
drive.advertise();
for (const x of [...Array(10).fill(0.3), 0]) {
  drive.publish({ linear: { x, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } });
  await pause(100);
}
console.log("drove");
process.exit(0);
