// How a job ended, or what is in doubt: cause and remedy, never more than was read.

import { h } from "../../core/dom.js";
import { number, sentence } from "../../core/words.js";
import { table } from "../parts.js";

/** @import { JobModel } from "../../mavcal.d.ts" */

const PROOF = { full: ["good", "Proved on the vehicle"], partial: ["warn", "Proved in part"], none: ["warn", "Written and read back, not proved"] };

/** @param {JobModel} job */
export function outcome(job) {
  const { outcome: told } = job;
  if (!told) return null;
  if (told.kind === "result") {
    const checked = job.verification !== null;
    const [tone, words] = PROOF[told.proof];
    return h("section", { class: `outcome ${checked ? tone : "good"}`, role: "status" },
      h("h2", {}, checked ? words : job.state === "reverted" ? "The old values are back" : "Done"),
      h("p", {}, sentence(told.text)),
      checked && told.proof !== "full" && told.proof_reason && !told.text.includes(told.proof_reason) ? h("p", {}, sentence(told.proof_reason)) : null);
  }
  return h("section", { class: `outcome ${told.kind === "write_failed" ? "warn" : "bad"}`, role: "status" },
    h("h2", {}, told.kind === "write_failed" ? "Nothing was written" : job.state === "cancelled" ? "Cancelled" : "It did not work"),
    h("p", {}, sentence(told.cause)),
    told.remedy ? h("p", { class: "remedy" }, h("strong", {}, "What helps: "), sentence(told.remedy)) : null);
}

/** @param {JobModel} job */
export function standing(job) {
  if (!job.standing.length) return null;
  return h("section", { class: "card bad", role: "alert" },
    h("h2", {}, "Parameters that are not certain"),
    table(["parameter", ">last heard", ">before", ">to be", "note"],
      job.standing.map((s) => [s.name, number(s.value, 7), number(s.old, 7), number(s.new, 7), s.note]), "Parameters that are not certain"));
}
