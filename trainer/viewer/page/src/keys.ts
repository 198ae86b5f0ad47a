// The page's keys, which leave to a field, a button and a tab what they do with a key themselves.

import { EpisodeList } from "./episodes";
import { Stage } from "./stage";

type Handler = (event: KeyboardEvent) => boolean; // whether the key was the page's

export function stageKeys(stage: Stage, list: EpisodeList): Handler {
  return (event) => {
    const actions: Record<string, () => void> = {
      " ": () => stage.toggle(),
      ArrowRight: () => stage.step(event.shiftKey ? 10 : 1),
      ArrowLeft: () => stage.step(event.shiftKey ? -10 : -1),
      ArrowDown: () => list.move(1),
      ArrowUp: () => list.move(-1),
      Home: () => stage.goTo(0),
      End: () => stage.goTo(stage.end),
      c: () => stage.resetCamera(),
      f: () => stage.toggleFollow(),
      l: () => stage.toggleLoop(),
      n: () => list.next(),
    };
    actions[event.key]?.();
    return event.key in actions;
  };
}

export function onKeys(handle: Handler, up: (event: KeyboardEvent) => void = () => {}): void {
  document.addEventListener("keydown", (event) => {
    const target = event.target instanceof Element ? event.target : document.body;
    const own =
      target.matches("select, textarea, input:not([type=range])") ||
      (target.matches("button, summary, a[href]") && (event.key === " " || event.key === "Enter")) ||
      (target.matches("[role=tab]") && ["ArrowLeft", "ArrowRight", "Home", "End"].includes(event.key)) ||
      (target.matches("[type=range]") && ["ArrowUp", "ArrowDown", "Home", "End"].includes(event.key));
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || own) return;
    if (handle(event)) event.preventDefault();
  });
  document.addEventListener("keyup", up);
}
