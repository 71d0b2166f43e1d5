// Decisions: what is read from the server and saved there, and what is taken back.

import { count } from "./dom";
import { ServerError } from "./source";
import { type RoadObject, State } from "./state";
import type { Corrections, Decision, Paint, PointGroup, Status, Wanted } from "./types";

export * from "./state";

const OWN = "mlsroad-own-"; // decisions of this tab about a folder, for a reload

const DONE: Record<string, string> = {
  accept: "accepted", reject: "rejected", merge: "merged", split: "split", move_base: "moved", note: "has a new note",
  accept_line: "accepted", reject_line: "rejected", shape_line: "moved", cut_line: "cut", join_lines: "joined", add_line: "added",
};

export class Model extends State {
  /** Group that was left out last, until something is saved. */
  private leftOut: PointGroup | null = null;
  private strokes = new Map<number, { rows: number[]; code: number }>();
  private mark = "";
  /** Decisions of this tab in order, those of one act together. */
  private own: number[][] = kept(this.survey.folder);
  /** Decisions that others made while the page was open. */
  private foreign = new Set<number>();
  private last: Promise<unknown> = Promise.resolve();
  private waiting = 0;

  /** Choose a group of points and mark them. */
  async selectGroup(group: PointGroup): Promise<void> {
    this.select(null);
    this.group = group;
    this.emit("selection");
    try {
      const rows = await this.source.group(group);
      if (this.group !== group) return;
      this.highlighted = new Set(rows);
      this.emit("paint");
      this.emit("selection");
    } catch (error) {
      this.report(error, "The points of this place cannot be read");
    }
  }

  /** Give the points of a group a class, also the one that they have. */
  async answer(group: PointGroup, name: string): Promise<boolean> {
    const done = await this.paint({ places: [group.place], radius: 1, class: name, only: group.code, group: true });
    if (done) this.drop(group);
    return done;
  }

  /** Ask about a group no more while the page is open. */
  async leaveOut(group: PointGroup): Promise<void> {
    try {
      await this.source.leaveOut(group, false);
      this.leftOut = group;
      this.drop(group);
    } catch (error) {
      this.report(error, "Not left out");
    }
  }

  private drop(group: PointGroup): void {
    this.groups = this.groups.filter((other) => other !== group);
    if (this.group === group) this.leaveGroup();
    this.emit("queue");
  }

  async loadGroups(): Promise<void> {
    try {
      this.groups = await this.source.groups(50);
      this.emit("queue");
    } catch (error) {
      this.report(error, "Places cannot be listed");
    }
  }

  async load(): Promise<void> {
    try {
      this.takeAll(await this.source.corrections());
      await this.readQueue();
    } catch (error) {
      this.report(error, "Decisions cannot be read");
    }
  }

  private async readQueue(): Promise<void> {
    this.queue = await this.source.queue(100);
    this.queued = true;
    this.emit("queue");
  }

  private takeAll(found: Corrections): void {
    this.strokes = new Map(found.painted.map((stroke) => [stroke.id, { rows: stroke.rows, code: this.codeOf(stroke.class) }]));
    this.take(found);
    this.repaint();
  }

  private repaint(): void {
    this.painted.clear();
    for (const [, stroke] of [...this.strokes].sort(([a], [b]) => a - b)) for (const row of stroke.rows) this.painted.set(row, stroke.code);
    this.emit("paint");
  }

  private take(found: Corrections): void {
    this.mark = found.mark;
    if (this.accept(found)) this.emit("paint");
    this.emit("decisions");
  }

  private async refresh(): Promise<void> {
    this.take(await this.source.states());
    await this.readQueue();
  }

  /** Take what other tabs and programs have decided; `status` is the last answer about the state of the survey. */
  async follow(status: Status): Promise<void> {
    if (this.busy || status.mark === this.mark || status.state === "stale") return;
    const before = new Set(this.decisions.map((decision) => decision.id));
    const own = new Set(this.own.flat());
    const found = await this.source.states();
    if (this.busy) return; // what is being saved now reads again
    for (const { id } of found.decisions) if (!before.has(id) && !own.has(id)) this.foreign.add(id);
    const strokes = found.decisions.filter((decision) => decision.action === "paint").map((decision) => decision.id);
    const same = strokes.every((id) => this.strokes.has(id)) && this.strokes.size === strokes.length;
    if (same) this.take(found);
    else this.takeAll(await this.source.corrections());
    await this.readQueue();
  }

  private report(error: unknown, what: string): void {
    const reason = error instanceof ServerError ? error.message : String(error);
    this.set("saved", "saved", { text: `${what}: ${reason}`, kind: "bad" });
  }

  /** Whether an answer is awaited; the lists and the next object are not shown yet. */
  get busy(): boolean {
    return this.waiting > 0;
  }

  /** Send a decision; true once the server has it on disk. */
  async decide(wanted: Wanted): Promise<boolean> {
    return this.save(async () => {
      const said = this.said(wanted); // by the kind of before
      const { ids } = await this.source.decide(wanted);
      this.keep([...this.own, ids]);
      return said;
    });
  }

  /** Send decisions that are written, and taken back, together. */
  async decideAll(all: Wanted[], said: string): Promise<boolean> {
    return this.save(async () => {
      const { ids } = await this.source.decide({ all });
      this.keep([...this.own, ids]);
      return said;
    });
  }

  private said({ action, kind, payload, object_id }: Wanted): string {
    const given = String(payload?.to ?? payload?.class ?? kind ?? "");
    const object = [...this.objects].find(({ id, made }) => id === object_id || (made && made.decision === payload?.added));
    if (action === "check") return `${kind} ${payload!.entry}: the state is ${payload!.checked}`;
    const what = object ? title(object) : payload?.line ? `${kind} ${payload.line}` : given;
    const done = action === "other_kind" || action === "kind_line" ? `is ${given} now` : (DONE[action] ?? "added");
    return `${what} ${done}`.replaceAll("_", " ");
  }

  async paint(wanted: Paint): Promise<boolean> {
    return this.save(async () => {
      const { ids, rows, before } = await this.source.paint(wanted);
      if (!ids.length) throw new ServerError("there is no point to paint here");
      const code = this.codeOf(wanted.class);
      for (const id of ids.slice(0, -1)) this.strokes.set(id, { rows: [], code });
      this.strokes.set(ids[ids.length - 1], { rows, code });
      for (const row of rows) this.painted.set(row, code);
      this.keep([...this.own, ids]);
      this.emit("paint");
      const names = Object.keys(before).map((from) => this.className(Number(from)));
      const others = names.filter((name) => name !== wanted.class);
      return `${count(rows.length)} points: ${others.length ? `${others.join(", ")} to ` : ""}${wanted.class}`;
    });
  }

  private keep(own: number[][]): void {
    this.own = own;
    try {
      sessionStorage.setItem(OWN + this.survey.folder, JSON.stringify(own));
    } catch {
      // an exported page may have no storage
    }
  }

  /** Decisions to take back: the last ones of this tab, else those of the user that no other tab made. */
  get undoable(): number[] {
    const valid = new Set(this.decisions.map((decision) => decision.id));
    const own = [...this.own].reverse().find((ids) => ids.some((id) => valid.has(id)));
    if (own) return own.filter((id) => valid.has(id));
    const free = this.decisions.filter((decision) => decision.who === this.survey.user && !this.foreign.has(decision.id));
    const made = free.at(-1)?.made; // decisions that were made together have one time
    return free.filter((decision) => decision.made === made).map(({ id }) => id);
  }

  /** Take a decision back, by default the last one of this tab; return it. */
  async undo(chosen?: number): Promise<Decision | null> {
    const { leftOut } = this;
    if (leftOut && chosen === undefined) {
      this.leftOut = null;
      try {
        await this.source.leaveOut(leftOut, true);
        this.groups = [leftOut, ...this.groups];
        this.emit("queue");
      } catch (error) {
        this.report(error, "Not undone");
      }
      return null;
    }
    let undone: Decision | null = null;
    await this.save(async () => {
      const ids = chosen === undefined ? this.undoable : [chosen]; // after what was being saved
      const decision = this.decisions.find(({ id }) => id === ids.at(-1));
      if (!decision) return "Nothing of yours to undo";
      await this.source.undo(ids);
      undone = decision;
      if (ids.filter((id) => this.strokes.delete(id)).length) this.repaint();
      if (this.groups.length) this.groups = await this.source.groups(50); // an answer that was taken back is asked again
      if (ids.length > 1 && decision.action !== "paint") {
        undone = null;
        return `Undone: ${ids.length} decisions, ${decision.action.replace("_", " ")}`;
      }
      const about = decision.object_id ? ` ${decision.object_id}` : "";
      return `Undone: ${decision.action.replace("_", " ")}${about} ${decision.what}`.trim();
    });
    return undone;
  }

  /** Save once all that is being saved is finished, such as the first part of a long stroke. */
  private async save(act: () => Promise<string>): Promise<boolean> {
    this.waiting++;
    this.leftOut = null;
    const own = this.last.then(() => this.saveNow(act));
    this.last = own.catch(() => false);
    try {
      return await own;
    } finally {
      this.waiting--;
    }
  }

  private async saveNow(act: () => Promise<string>): Promise<boolean> {
    if (this.source.readOnly) {
      this.report(new ServerError("this page is a copy to look at"), "Not saved");
      return false;
    }
    this.set("saved", "saved", { text: "Saving", kind: "busy" });
    const begin = performance.now();
    let done: string;
    try {
      done = await act();
    } catch (error) {
      this.report(error, "Not saved");
      return false;
    }
    const milliseconds = Math.round(performance.now() - begin);
    const undo = done.startsWith("Undone") || done.startsWith("Nothing") ? "" : " Undo U";
    this.set("saved", "saved", { text: `${done}. Saved at ${new Date().toLocaleTimeString()} (${milliseconds} ms).${undo}`, kind: "ok" });
    try {
      await this.refresh();
    } catch (error) {
      this.report(error, "Saved, but the list is old");
    }
    return true;
  }
}

function title(object: RoadObject): string {
  return `${object.kind} ${object.id}`;
}

function kept(folder: string): number[][] {
  try {
    const found = JSON.parse(sessionStorage.getItem(OWN + folder) ?? "[]");
    return Array.isArray(found) ? found : [];
  } catch {
    return []; // an exported page may have no storage
  }
}
