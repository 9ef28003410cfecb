// The source of frames in Python, over a WebSocket.
const PATIENCE = 500; // ms until the next attempt to connect

export class PythonSource {
    lead = 1; // samples asked for ahead of time, so that an answer that is late by less holds no picture up

    /** Connect; lost() is called when the connection is gone, back() when it is there again. */
    constructor(lost, back) {
        Object.assign(this, { lost, back, waiting: new Map(), id: 0, closed: false });
        this.connect();
    }

    connect() {
        const url = new URL("socket", location.href.split("#")[0]);
        url.protocol = "ws:";
        url.search = location.search;
        this.opened = new Promise((resolve) => {
            const socket = new WebSocket(url);
            socket.onopen = () => {
                this.socket = socket;
                resolve();
                if (this.wasLost) this.back();
                this.wasLost = false;
            };
            socket.onmessage = (event) => this.hear(JSON.parse(event.data));
            socket.onclose = (event) => this.gone(event);
        });
    }

    hear(answer) {
        const asked = this.waiting.get(answer.id);
        this.waiting.delete(answer.id);
        if (!asked) {
            if (answer.error) this.refusal = answer.error;
        } else if (answer.error || answer.lost)
            asked.reject(Object.assign(new Error(answer.error ?? answer.lost), answer));
        else asked.resolve(answer);
    }

    gone(event) {
        for (const asked of this.waiting.values())
            asked.reject(Object.assign(new Error("connection"), { gone: true }));
        this.waiting.clear();
        this.socket = null;
        if (this.closed) return;
        this.wasLost = true;
        this.lost(event.code === 1013 ? this.refusal : "The connection to Python was lost; trying again.");
        setTimeout(() => this.closed || this.connect(), event.code === 1013 ? 10 * PATIENCE : PATIENCE);
    }

    async ask(message) {
        await this.opened;
        if (this.socket?.readyState !== WebSocket.OPEN)
            throw Object.assign(new Error("connection"), { gone: true });
        const id = ++this.id;
        return new Promise((resolve, reject) => {
            this.waiting.set(id, { resolve, reject });
            this.socket.send(JSON.stringify({ id, ...message }));
        });
    }

    async scene(message) {
        const states = message.states.map((each) => Array.from(each));
        return this.ask({ do: "scene", ...message, states });
    }

    async advance(n, push) {
        return this.ask({ do: "advance", n, push });
    }

    /** Leave, whatever is being waited for. */
    close() {
        this.closed = true;
        this.socket?.close();
    }
}
