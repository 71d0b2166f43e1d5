// Decisions about all marked objects or lines together.

import { ask } from "./ask";
import type { Lines } from "./lines";
import { KINDS, LINE_KINDS, type Model } from "./model";
import type { Wanted } from "./types";

/** What decisions about several need of the actions. */
interface Host {
  readonly model: Model;
  readonly lines: Lines;
  hint(text: string, holds: () => boolean): void;
}

export class Together {
  constructor(private readonly actions: Host) {}

  /** Decide about all marked objects or lines together. */
  async decide(action: string, done: string, kind = "", name = ""): Promise<void> {
    const { model } = this.actions;
    if (model.busy) return;
    const ids = [...model.marked];
    const lines = model.list === "lines";
    const wanted = lines
      ? ids.map((id) => this.actions.lines.wanted(model.lineOf(id)!, `${action}_line`, kind ? { to: kind } : {}))
      : ids.filter((id) => !model.byId.get(id)!.made).map((id): Wanted => ({ action, object_id: id, ...(kind ? { kind } : {}), payload: name ? { class: name } : {} }));
    const left = ids.length - wanted.length; // objects that a decision made
    if (!wanted.length) return this.actions.hint("Decisions made these objects: take them back to change them.", () => model.marked.size > 0);
    const said = `${wanted.length} ${lines ? "lines" : "objects"} ${done}${left ? `, ${left} added ones left out` : ""}`;
    if (await model.decideAll(wanted, said)) model.setMarked([]);
  }

  askKind(): void {
    const { model } = this.actions;
    const lines = model.list === "lines";
    const question = `What are the ${model.marked.size} marked ${lines ? "lines" : "objects"}?`;
    ask(model, question, lines ? LINE_KINDS : KINDS, (kind, name) => {
      void this.decide(lines ? "kind" : "other_kind", `are ${(kind || name).replace("_", " ")} now`, kind, name);
    }, !lines);
  }
}
