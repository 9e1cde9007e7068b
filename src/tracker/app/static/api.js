// Requests to the server of this page. A refusal becomes an Error with the server's sentence.

async function read(response) {
  const answer = await response.json().catch(() => ({ error: `the workbench answers ${response.status}` }));
  if (!response.ok) throw Object.assign(new Error(answer.error), { status: response.status });
  return answer;
}

export async function get(address) {
  return read(await fetch(address));
}

export async function post(address, value = null) {
  const headers = { "Content-Type": "application/json" };
  return read(await fetch(address, { method: "POST", headers, body: JSON.stringify(value) }));
}

export function frameAddress(index, look, kind = "jpg") {
  return `/frame/${index}.${kind}?${new URLSearchParams(look)}`;
}

// The newest of several requests wins: calls while one is under way are dropped but for the last.
export function newestOnly(work) {
  let busy = false, waiting = null;
  return async function ask(...values) {
    if (busy) { waiting = values; return; }
    busy = true;
    try {
      await work(...values);
    } finally {
      busy = false;
      if (waiting) { const next = waiting; waiting = null; ask(...next); }
    }
  };
}

// One answer that is asked for before it is needed.
export class AskedAhead {
  constructor(ask) {
    this.ask = ask;
    this.forget();
  }

  forget() { this.address = this.answer = null; }

  prepare(address) {
    if (address === this.address) return;
    Object.assign(this, { address, answer: this.ask(address) });
    this.answer.catch(() => {}); // whoever takes it hears of it
  }

  take(address) {
    const answer = address === this.address ? this.answer : this.ask(address);
    this.forget();
    return answer;
  }
}
