// What the panel knows: one copy of the service's state, kept fresh by one event stream.

import { ask, follow, KeyNeeded, Unreachable } from "./service.js";
import { here, whenMoved } from "./route.js";

/**
 * @import { JobEvent, JobModel, JobSummary, LinkModel, ProcedureModel, RecordingModel, VehicleModel } from "../mavcal.d.ts"
 * @import { Place } from "./route.js"
 */

const LOOK_MS = 5000; // a vehicle that has gone sends no event
const NEWEST = 60;

/** @typedef {{ good: boolean, text: string }} Connection */

class Store {
  constructor() {
    /** @type {Place} */
    this.place = here();
    /** @type {Connection} */
    this.connection = { good: false, text: "Connecting …" };
    this.keyNeeded = false;
    this.ready = false;
    /** @type {Map<string, VehicleModel>} */
    this.vehicles = new Map();
    /** @type {Map<string, string>} Names that people gave, by vehicle. */
    this.names = new Map();
    /** @type {Map<string, string[]>} Tags that people gave, by vehicle. */
    this.tags = new Map();
    /** @type {Map<string, LinkModel>} */
    this.links = new Map();
    /** @type {Map<string, JobSummary>} */
    this.jobs = new Map();
    /** @type {Map<string, JobModel>} Jobs whose results were asked for. */
    this.full = new Map();
    /** @type {ProcedureModel[]} */
    this.procedures = [];
    /** @type {Map<string, RecordingModel>} */
    this.recordings = new Map();
    /** @type {string} A message that needs attention; never over the prompt. */
    this.notice = "";
    /** @type {Map<string, any>} What views keep between drawings, by name. */
    this.kept = new Map();
    this._draw = () => {};
    this._asked = false;
    this._lostAt = Date.now();
    this._stop = () => {};
  }

  /** Have the page drawn at the next frame. */
  changed() {
    if (this._asked) return;
    this._asked = true;
    requestAnimationFrame(() => {
      this._asked = false;
      this._draw();
    });
  }

  /** Begin; `draw` is called whenever something has changed. @param {() => void} draw */
  begin(draw) {
    this._draw = draw;
    whenMoved(() => {
      this.place = here();
      this.notice = "";
      this.changed();
    });
    this._follow();
    setInterval(() => { if (this.connection.good) this._look().catch(() => {}); }, LOOK_MS);
    this.changed();
  }

  /** Begin again, with another key. */
  again() {
    this.keyNeeded = false;
    this._stop();
    this._follow();
    this.changed();
  }

  _follow() {
    this._stop = follow("follow_events", {}, ["job", "vehicle", "link"], {
      told: (name, data) => this._told(name, data),
      opened: () => {
        this.connection = { good: true, text: "Live" };
        this.refresh().catch((error) => this.complain(error));
      },
      lost: (error) => {
        if (this.connection.good) this._lostAt = Date.now();
        this.connection = { good: false, text: error instanceof KeyNeeded ? "No key" : this._unreached(error) };
        this.keyNeeded ||= error instanceof KeyNeeded;
        this.changed();
      },
    });
  }

  /** @param {Error} error */
  _unreached(error) {
    return error instanceof Unreachable ? `Service not reached since ${new Date(this._lostAt).toLocaleTimeString()}` : error.message;
  }

  /** Read everything again. */
  async refresh() {
    if (!this.procedures.length) this.procedures = await ask("list_procedures");
    const jobs = await ask("list_jobs", { query: { order: "newest", limit: NEWEST } });
    this.jobs = byId(jobs);
    const units = await ask("list_fleet", { query: { limit: 1000 } });
    this.names = new Map(units.map((unit) => [unit.unit, unit.name]));
    this.tags = new Map(units.map((unit) => [unit.unit, unit.tags]));
    await this._look();
    await Promise.all([...this.full.keys()].map((id) => this.load(id)));
    this.ready = true;
    this.changed();
  }

  async _look() {
    const [vehicles, links] = await Promise.all([ask("list_vehicles"), ask("list_links")]);
    this.vehicles = byId(vehicles);
    this.links = byId(links);
    this.changed();
  }

  /** Read one job with its results. @param {string} id */
  async load(id) {
    const job = await ask("get_job", { parameters: { job_id: id } });
    this.full.set(id, job);
    this.jobs.set(id, job);
    this.changed();
    return job;
  }

  /** @param {string} name @param {any} data */
  _told(name, data) {
    if (name === "vehicle") this.vehicles.set(data.id, data);
    if (name === "link") this.links.set(data.id, data);
    if (name === "job") this._happened(/** @type {JobEvent} */ (data));
    this.changed();
  }

  /** @param {JobEvent} event */
  _happened(event) {
    const id = event.job_id;
    const known = [this.full.get(id), this.jobs.get(id)].filter((job) => job !== undefined);
    if (event.kind === "progress") {
      for (const job of known) job.progress = event.data;
    } else if (event.kind === "prompt") {
      for (const job of known) job.prompt = "text" in event.data ? event.data : null;
    }
    const small = event.kind === "progress" || event.kind === "prompt";
    if (!small || !known.length) this.load(id).catch((error) => this.complain(error));
  }

  /** Do something, read again what it changed, and say what went wrong. @template T @param {() => Promise<T>} act */
  async act(act) {
    this.notice = "";
    try {
      return await act();
    } catch (error) {
      this.complain(/** @type {Error} */ (error));
      return undefined;
    } finally {
      this.changed();
    }
  }

  /** @param {Error} error */
  complain(error) {
    if (error instanceof KeyNeeded) this.keyNeeded = true;
    else this.notice = error.message;
    this.changed();
  }

  /**
   * Something a view keeps between drawings.
   * @template T @param {string} name @param {() => T} first @returns {T}
   */
  keep(name, first) {
    if (!this.kept.has(name)) this.kept.set(name, first());
    return this.kept.get(name);
  }

  /**
   * The answer to a question of the service, asked once and again after `maxAge` ms; undefined until it is there.
   * @template T @param {string} name @param {() => Promise<T>} question @returns {T | undefined}
   */
  answer(name, question, maxAge = 30000) {
    const entry = this.keep(`answer ${name}`, () => ({ value: /** @type {T | undefined} */ (undefined), at: 0, asking: false }));
    if (!entry.asking && Date.now() - entry.at > maxAge && this.connection.good) {
      entry.asking = true;
      question()
        .then((value) => { entry.value = value; })
        .catch((error) => this.complain(error))
        .finally(() => {
          entry.at = Date.now();
          entry.asking = false;
          this.changed();
        });
    }
    return entry.value;
  }

  /** Ask this question again at the next drawing. @param {string} name */
  forget(name) {
    this.kept.delete(`answer ${name}`);
  }

  /** The job that claims a vehicle now, if any. @param {string} vehicle */
  running(vehicle) {
    return this.newest().find((job) => job.vehicle_id === vehicle && BUSY.has(job.state));
  }

  /** Jobs, newest first. */
  newest() {
    return [...this.jobs.values()].sort((a, b) => b.created_at - a.created_at);
  }
}

/** States in which a job claims its vehicle. */
export const BUSY = new Set(["queued", "running", "waiting_for_operator", "fitting", "applying", "waiting_for_reboot",
  "verifying", "rolling_back", "in_doubt"]);
/** States in which nothing goes on by itself. */
export const ENDED = new Set(["succeeded", "reverted", "failed", "cancelled", "interrupted"]);
/** States in which a job can be cancelled without a trace. */
export const CANCELLABLE = new Set(["queued", "running", "waiting_for_operator", "fitting", "review"]);

/** @template {{ id: string }} T @param {T[]} items */
const byId = (items) => new Map(items.map((item) => [item.id, item]));

export const store = new Store();
