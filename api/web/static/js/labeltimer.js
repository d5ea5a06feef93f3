// How long somebody works: the time between actions, but no longer breaks.

const LONGEST_BREAK_S = 10;

/** Seconds of work at an instant and at each of its vehicles. */
export class WorkTimer {
  constructor() {
    this.last = performance.now();
    this.start(0);
  }

  /** Go on with an instant. @param {number} seconds that were worked on it before */
  start(seconds) {
    this.seconds = seconds;
    /** @type {Map<number, number>} since the vehicle was last saved */
    this.vehicles = new Map();
    this.last = performance.now();
  }

  /** Somebody does something. @param {number|null} vehicle at which of them */
  act(vehicle) {
    const now = performance.now(), passed = Math.min((now - this.last) / 1000, LONGEST_BREAK_S);
    this.last = now;
    this.seconds += passed;
    if (vehicle !== null) this.vehicles.set(vehicle, (this.vehicles.get(vehicle) ?? 0) + passed);
  }
}
