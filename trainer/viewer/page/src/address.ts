// The place that the page's address names, after its "#": a run, an episode, a time, and a run beside it.

export interface Place {
  run: string;
  episode: number;
  seconds: number;
  beside: string | null;
}

// Null if the address names no episode.
export function readPlace(): Place | null {
  const named = new URLSearchParams(location.hash.slice(1));
  const [run, episode, time] = [named.get("run"), named.get("episode"), Number(named.get("t") ?? 0)];
  if (!run || !episode || !/^\d+$/.test(episode)) return null;
  return { run, episode: Number(episode), seconds: Number.isFinite(time) ? time : 0, beside: named.get("beside") };
}

let waiting: number | undefined;

// Soon, and without a new entry in the browser's history; the latest of several places counts.
export function writePlace(place: { run: string; episode: number; time: string; beside: string | null } | null): void {
  clearTimeout(waiting);
  waiting = setTimeout(() => {
    const named = new URLSearchParams();
    if (place) {
      named.set("run", place.run);
      named.set("episode", String(place.episode));
      named.set("t", place.time);
      if (place.beside) named.set("beside", place.beside);
    }
    const address = place ? `#${named}` : location.pathname + location.search;
    if (place ? location.hash !== address : location.hash) history.replaceState(null, "", address);
  }, 150);
}
