// One page, three uses: a replay from disk, `corridor watch` beside a training run, and a study's report.

import "uplot/dist/uPlot.min.css";
import "./page.css";
import { readPlace, writePlace } from "./address";
import { PageData, Scene, element, seconds } from "./data";
import { EpisodeList } from "./episodes";
import { onKeys, stageKeys } from "./keys";
import { END, Stage, speak } from "./stage";
import { showStudy, wayBack } from "./study";
import { describe, say } from "./words";
import { watch } from "./watch";

function start(data: PageData): void {
  if (data.mode === "study") {
    element("title").textContent = data.study.title;
    element("subtitle").textContent = data.study.facts.join(" · ");
    say(...data.study.notes);
    showStudy(data.study);
    return;
  }
  const stage = new Stage();
  const list = new EpisodeList(stage, say);
  stage.onEnd = () => speak(`${END[stage.track?.outcome ?? "ended"]}, the episode is over.`);
  (window as any).corridor = { stage, list }; // for a look from the browser's console
  if (data.mode === "replay") replay(data.scene, stage, list);
  else watch(data, stage, list);
}

function replay(scene: Scene, stage: Stage, list: EpisodeList): void {
  element("title").textContent = "Replay";
  document.title = `${scene.run.run_id} · corridor replay`;
  element("subtitle").textContent = describe(scene);
  element("subtitle").after(...[wayBack()].filter((link) => link !== null));
  element("episodes").hidden = false;
  onKeys(stageKeys(stage, list));
  const open = async () => {
    const place = readPlace();
    const here = place && place.run === scene.run.run_id && scene.episodes.some((record) => record.number === place.episode);
    say(...scene.notes, place && !here ? `This page has no episode ${place.episode} of ${place.run}; another is shown.` : null);
    await list.setScene(scene, here ? place.episode : undefined, here ? place.seconds : 0);
  };
  stage.onRest = () => {
    if (list.onStage === null || list.onStage !== list.current?.number) return;
    const time = seconds(Math.floor(stage.time), scene.corridor.decision_seconds);
    writePlace({ run: scene.run.run_id, episode: list.onStage, time, beside: null });
  };
  addEventListener("hashchange", () => void open());
  void open();
}

try {
  start(JSON.parse(element("data").textContent!));
} catch (error) {
  say(`This page's data is broken and can't be shown (${(error as Error).message}).`);
}
