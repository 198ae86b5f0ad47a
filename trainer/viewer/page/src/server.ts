// The page's connection to the local process behind `corridor watch`.

export class Server {
  constructor(private readonly token: string) {}

  get(path: string): Promise<any> {
    return this.ask(path, { headers: { "X-Corridor-Token": this.token } });
  }

  post(path: string, body: unknown): Promise<any> {
    return this.ask(path, {
      method: "POST",
      headers: { "X-Corridor-Token": this.token, "Content-Type": "application/json" },
      body: JSON.stringify(body),
    });
  }

  // Throws an Error whose message can be shown as it is.
  private async ask(path: string, options: RequestInit): Promise<any> {
    let response: Response;
    try {
      response = await fetch(path, { ...options, cache: "no-store" });
    } catch {
      throw new Error("corridor watch does not answer; what was read last stays, and the page goes on asking.");
    }
    const answer = await response.json().catch(() => ({ error: `corridor watch answered ${response.status}.` }));
    if (!response.ok) throw new Error(answer.error);
    return answer;
  }
}
