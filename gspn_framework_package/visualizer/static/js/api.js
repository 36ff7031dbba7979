// Requests to this page's server, and the stream of news: server-sent events, or polling if they are not available.

class ApiError extends Error {
  /** `data`: the rest of the server's answer: `fields` (name -> what is wrong with it), `exists`. */
  constructor(message, status, data = {}) {
    super(message);
    this.status = status;
    this.data = data;
  }
}

/** Send a request; resolves to the response if it was successful. */
async function request(path, query, options) {
  const text = new URLSearchParams(query).toString();
  const address = `/api/${path}${text ? `?${text}` : ""}`;
  let response;
  try {
    response = await fetch(address, { credentials: "same-origin", cache: "no-store", ...options });
  } catch {
    throw new ApiError("the server does not answer", 0);
  }
  if (response.ok) return response;
  const data = await response.json().catch(() => ({}));
  const message = data.error || `the server answered ${response.status}`;
  throw new ApiError(message, response.status, data);
}

async function answerOf(sent) {
  const response = await sent;
  return response.json().catch(() => {
    throw new ApiError("the server's answer cannot be read", response.status);
  });
}

/** Post a request whose answer is a file; resolves to the response. */
export const send = (path, body = {}, query = {}) =>
  request(path, query, {
    method: "POST",
    headers: { "Content-Type": "application/json", "X-Gspn-Page": "1" },
    body: JSON.stringify(body),
  });

export const get = (path, query = {}, options = {}) => answerOf(request(path, query, options));

export const post = (path, body, query) => answerOf(send(path, body, query));

const SILENCE = 8000; // ms without even a ping after which the stream is considered dead
const POLL = 500; // ms between polls
const RETRY = 1000; // ms before another attempt

/** Follows one open net. `onNews(news)` receives the messages of the server's hub, `onState(state, heard, why)` a
 * state: waiting, open, polling, lost, gone (why) or locked; `heard`: performance.now() of the server's last message.
 */
export class NewsStream {
  constructor(id, onNews, onState) {
    this.id = id;
    this.onNews = onNews;
    this.onState = onState;
    this.cursor = "";
    this.heard = performance.now(); // last message of the server
    this.begun = this.heard; // last attempt to open the stream, or its last message
    this.closed = false;
    this.polls = false;
    this.watch = setInterval(() => this.check(), 1000);
    this.open();
  }

  open() {
    if (this.closed) return;
    this.begun = performance.now();
    const query = new URLSearchParams({ id: this.id });
    if (this.cursor) query.set("since", this.cursor);
    const source = new EventSource(`/api/stream?${query}`);
    this.source = source;
    source.onopen = () => {
      this.hear();
      this.say("open");
    };
    source.addEventListener("ping", () => this.hear());
    source.onmessage = (message) => {
      this.hear();
      this.take(JSON.parse(message.data));
    };
    source.addEventListener("closed", (message) => {
      source.close();
      this.closed = true;
      this.say("gone", JSON.parse(message.data).reason);
    });
    source.onerror = () => {
      // The stream was refused (too many viewers) or broke: poll once, which also gives the reason.
      source.close();
      if (this.source === source) {
        this.source = null;
        this.poll();
      }
    };
  }

  hear() {
    this.heard = this.begun = performance.now();
  }

  say(state, why = "") {
    this.onState(state, this.heard, why);
  }

  take(news) {
    this.cursor = news.cursor;
    this.onNews(news);
  }

  async poll() {
    if (this.closed || this.source) return;
    try {
      const news = await get(
        "poll",
        this.cursor ? { id: this.id, since: this.cursor } : { id: this.id },
        { signal: AbortSignal.timeout(SILENCE) },
      );
      if (this.closed) return;
      this.hear();
      this.take(news);
      if (this.polls) {
        this.say("polling");
        setTimeout(() => this.poll(), news.more ? 0 : POLL);
      } else {
        // the server answers: try the stream again, and keep polling if it is refused again
        this.polls = true;
        this.open();
        setTimeout(() => {
          if (this.source) this.polls = false;
        }, 4 * RETRY);
      }
    } catch (error) {
      if (this.closed) return;
      this.polls = false;
      if (error.status === 400 || error.status === 401) {
        this.say(error.status === 401 ? "locked" : "gone", error.message);
        if (error.status === 400) return;
      } else {
        this.say("lost");
      }
      setTimeout(() => (this.polls ? this.poll() : this.retry()), RETRY);
    }
  }

  retry() {
    if (!this.closed && !this.source) this.poll();
  }

  check() {
    if (this.source && performance.now() - this.begun > SILENCE) {
      this.source.close();
      this.source = null;
      this.say("lost");
      this.poll();
    }
  }

  /** Start again and load everything shown. */
  again() {
    this.source?.close();
    this.source = null;
    this.cursor = "";
    setTimeout(() => this.retry(), RETRY);
  }

  close() {
    this.closed = true;
    clearInterval(this.watch);
    if (this.source) this.source.close();
    this.source = null;
  }
}
