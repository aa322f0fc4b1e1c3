// npm's roslib, unmodified, against a rosbridge: node roslib_client.mjs FOLDER ADDRESS
// FOLDER: where node_modules is. Prints what it saw as JSON.

import { pathToFileURL } from "node:url";

const [folder, address] = process.argv.slice(2);
const { Ros, Service, Topic } = await import(pathToFileURL(`${folder}/node_modules/roslib/dist/RosLib.js`));

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const twist = (x) => ({ linear: { x, y: 0, z: 0 }, angular: { x: 0, y: 0, z: 0 } });
const last = (rows) => rows[rows.length - 1].twist.twist.linear.x;

const ros = new Ros();
await ros.connect(`ws://${address}`);
const odometry = [];
const scans = [];
const listen = (name, messageType, more) => new Topic({ ros, name, messageType, ...more });
listen("/odom_raw", "nav_msgs/Odometry").subscribe((row) => odometry.push(row));
listen("/scan0", "sensor_msgs/LaserScan", { throttle_rate: 500 }).subscribe((row) => scans.push(row));

const ask = (name, serviceType) =>
  new Promise((done) =>
    new Service({ ros, name, serviceType }).callService({}, (answer) => done(answer), (error) => done({ error })),
  );
const topics = await new Promise((done, failed) => ros.getTopics(done, failed));
const type = await new Promise((done, failed) => ros.getTopicType("/cmd_vel", done, failed));
const time = await ask("/rosapi/get_time", "rosapi/GetTime");
const refused = await ask("/no_such_service", "x/Y");

const drive = listen("/cmd_vel", "geometry_msgs/Twist");
const arm = listen("/arm6_joints", "arm_msgs/ArmJoints");
drive.advertise();
arm.advertise();
arm.publish({ joint1: 90, joint2: 120, joint3: 0, joint4: 0, joint5: 90, joint6: 180, time: 500 });
for (let at = 0; at < 10; at++) {
  drive.publish(twist(0.4));
  await pause(100);
}
const moved = last(odometry);
drive.publish(twist(0));
await pause(500);
const stood = last(odometry);
const at = odometry[odometry.length - 1].pose.pose.position.x;
for (let again = 0; again < 2; again++) {
  drive.publish(twist(0.4));
  await pause(100);
}
await pause(600); // and no zero: the base's firmware does it
const seen = { topics: topics.topics, type, time, refused, moved, stood, at, zeroed: last(odometry) };
console.log(JSON.stringify({ ...seen, odometry: odometry.length, scans: scans.length }));
process.exit(0);
