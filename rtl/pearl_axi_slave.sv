// SPDX-License-Identifier: MIT
// An AXI4 slave in front of the memory port: INCR, FIXED and WRAP bursts, narrow and unaligned
// beats, byte strobes. One burst at a time, reads and writes in turn. No output depends on an input of
// the same cycle.
//
// The memories behind take whole words only. A beat that writes part of a word reads the word
// first, which costs some cycles; whole words stream at one a cycle. Such a read is marked as a
// fetch, so that the port can refuse it as it would the write, and what is refused is not written.
// Exclusive accesses, cache, protection and quality-of-service hints are not looked at.
module pearl_axi_slave
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned ADDR_BITS = 16,
    parameter int unsigned ID_BITS = 4,
    localparam int unsigned STRB_BITS = DATA_WL / 8,
    localparam int unsigned WORD_ADDR_BITS = ADDR_BITS - $clog2(STRB_BITS)
) (
    input logic clk_i,
    input logic rst_ni,

    // Named as the standard names them, without the suffixes of the other ports, because block
    // design tools and test libraries find an AXI interface by its names.
    input  logic [  ID_BITS-1:0] s_axi_awid,
    input  logic [ADDR_BITS-1:0] s_axi_awaddr,
    input  logic [          7:0] s_axi_awlen,
    input  logic [          2:0] s_axi_awsize,
    input  logic [          1:0] s_axi_awburst,
    input  logic                 s_axi_awvalid,
    output logic                 s_axi_awready,
    input  logic [  DATA_WL-1:0] s_axi_wdata,
    input  logic [STRB_BITS-1:0] s_axi_wstrb,
    input  logic                 s_axi_wlast,
    input  logic                 s_axi_wvalid,
    output logic                 s_axi_wready,
    output logic [  ID_BITS-1:0] s_axi_bid,
    output logic [          1:0] s_axi_bresp,
    output logic                 s_axi_bvalid,
    input  logic                 s_axi_bready,
    input  logic [  ID_BITS-1:0] s_axi_arid,
    input  logic [ADDR_BITS-1:0] s_axi_araddr,
    input  logic [          7:0] s_axi_arlen,
    input  logic [          2:0] s_axi_arsize,
    input  logic [          1:0] s_axi_arburst,
    input  logic                 s_axi_arvalid,
    output logic                 s_axi_arready,
    output logic [  ID_BITS-1:0] s_axi_rid,
    output logic [  DATA_WL-1:0] s_axi_rdata,
    output logic [          1:0] s_axi_rresp,
    output logic                 s_axi_rlast,
    output logic                 s_axi_rvalid,
    input  logic                 s_axi_rready,

    output logic                       req_o,
    output logic                       we_o,
    // The read is on behalf of a write of part of the word.
    output logic                       fetch_o,
    output logic  [WORD_ADDR_BITS-1:0] addr_o,
    output logic  [       DATA_WL-1:0] wdata_o,
    input  logic                       rvalid_i,
    input  logic  [       DATA_WL-1:0] rdata_i,
    input  resp_e                      resp_i
);

  // Enough for a word a cycle: of a read whose answer is taken at once, PORT_LATENCY + 2 cycles go by
  // from the request to that of the next one in its place.
  localparam int unsigned FIFO_DEPTH = 2 ** $clog2(PORT_LATENCY + 2);
  localparam int unsigned CREDIT_BITS = $clog2(FIFO_DEPTH + 1);

  // ---- The channels from the master, a cycle late ----

  typedef struct packed {
    logic [ID_BITS-1:0] id;
    logic [ADDR_BITS-1:0] addr;
    logic [7:0] len;
    logic [2:0] size;
    logic [1:0] burst;
  } burst_t;

  typedef struct packed {
    logic last;
    // All bytes are written, or none.
    logic full;
    logic empty;
    logic [STRB_BITS-1:0] strb;
    logic [DATA_WL-1:0] data;
  } beat_t;

  burst_t aw, ar, taken;
  beat_t w;
  logic aw_valid, aw_ready, w_valid, w_ready, ar_valid, ar_ready;

  pearl_slice #(
      .WIDTH($bits(burst_t))
  ) u_aw (
      .clk_i,
      .rst_ni,
      .valid_i(s_axi_awvalid),
      .ready_o(s_axi_awready),
      .data_i ({s_axi_awid, s_axi_awaddr, s_axi_awlen, s_axi_awsize, s_axi_awburst}),
      .valid_o(aw_valid),
      .ready_i(aw_ready),
      .data_o (aw)
  );

  pearl_slice #(
      .WIDTH($bits(beat_t))
  ) u_w (
      .clk_i,
      .rst_ni,
      .valid_i(s_axi_wvalid),
      .ready_o(s_axi_wready),
      .data_i ({s_axi_wlast, &s_axi_wstrb, s_axi_wstrb == '0, s_axi_wstrb, s_axi_wdata}),
      .valid_o(w_valid),
      .ready_i(w_ready),
      .data_o (w)
  );

  pearl_slice #(
      .WIDTH($bits(burst_t))
  ) u_ar (
      .clk_i,
      .rst_ni,
      .valid_i(s_axi_arvalid),
      .ready_o(s_axi_arready),
      .data_i ({s_axi_arid, s_axi_araddr, s_axi_arlen, s_axi_arsize, s_axi_arburst}),
      .valid_o(ar_valid),
      .ready_i(ar_ready),
      .data_o (ar)
  );

  // ---- A burst after the other ----

  typedef enum logic [2:0] {
    Idle,
    // Works out the addresses.
    Begin,
    Read,
    Write,
    // A partial beat: waits for the word that it changes a part of, and writes what they make.
    Fetch,
    Merge,
    // All beats are written: waits for the last answer.
    Drain,
    Respond
  } state_e;

  state_e state_d, state_q;
  logic [ID_BITS-1:0] id_q;
  // Beats to ask for and to answer, less one.
  logic [7:0] asks_q, answers_q;
  logic [CREDIT_BITS-1:0] credits_q;
  // The burst under way, or the last one, writes: a read comes before the next write.
  logic writes_q;
  resp_e resp_d, resp_q;

  logic choose_aw, take, beat_done, all_asked_q;
  logic read_req, push, pop, answer_valid;
  logic [ADDR_BITS-1:0] addr;
  // The master has placed the bytes, and counts on whole words.
  logic unused_addr;
  assign unused_addr = ^addr;
  resp_e answer_resp;
  logic [DATA_WL-1:0] answer_data;

  assign choose_aw = aw_valid && (!writes_q || !ar_valid);
  assign take = state_q == Idle && (aw_valid || ar_valid);
  assign aw_ready = state_q == Idle && choose_aw;
  assign ar_ready = state_q == Idle && !choose_aw;
  assign taken = choose_aw ? aw : ar;

  pearl_axi_address #(
      .ADDR_BITS(ADDR_BITS)
  ) u_address (
      .clk_i,
      .rst_ni,
      .start_i(take),
      .addr_i (taken.addr),
      .len_i  (taken.len),
      .size_i (taken.size),
      .burst_i(taken.burst),
      .next_i (beat_done),
      .addr_o (addr)
  );

  // Which answer is the word that was fetched: those of earlier writes come before it.
  logic [PORT_LATENCY-1:0] fetches_q;
  logic fetched, refused_q;
  assign fetched   = fetches_q[PORT_LATENCY-1];

  assign read_req  = state_q == Read && !all_asked_q && credits_q != '0;
  assign w_ready   = (state_q == Write && (w.full || w.empty)) || state_q == Merge;
  assign beat_done = read_req || (w_valid && w_ready);

  always_comb begin
    req_o   = 1'b0;
    we_o    = 1'b0;
    fetch_o = 1'b0;
    unique case (state_q)
      Read: req_o = read_req;
      Write: begin
        req_o   = w_valid && !w.empty;
        we_o    = w.full;
        fetch_o = w_valid && !w.empty && !w.full;
      end
      Merge: begin
        req_o = !refused_q;
        we_o  = 1'b1;
      end
      default: ;
    endcase
  end

  assign addr_o = addr[ADDR_BITS-1-:WORD_ADDR_BITS];
  for (genvar i = 0; i < STRB_BITS; i++) begin : gen_merge
    assign wdata_o[i*8+:8] = w.strb[i] ? w.data[i*8+:8] : answer_data[i*8+:8];
  end

  always_comb begin
    state_d = state_q;
    unique case (state_q)
      Idle: if (take) state_d = Begin;
      Begin: state_d = writes_q ? Write : Read;
      Read: if (pop && s_axi_rlast) state_d = Idle;
      Write: begin
        if (w_valid) begin
          if (!w_ready) state_d = Fetch;
          else if (w.last) state_d = Drain;
        end
      end
      Fetch: if (fetched) state_d = Merge;
      Merge: state_d = w.last ? Drain : Write;
      Drain: if (32'(credits_q) == FIFO_DEPTH) state_d = Respond;
      Respond: if (s_axi_bready) state_d = Idle;
    endcase
  end

  // The worst answer of a burst's beats is the burst's.
  always_comb begin
    resp_d = resp_q;
    if (state_q == Idle) resp_d = RespOkay;
    else if (rvalid_i && resp_i > resp_q) resp_d = resp_i;
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      state_q   <= Idle;
      writes_q  <= 1'b1;
      credits_q <= CREDIT_BITS'(FIFO_DEPTH);
      fetches_q <= '0;
    end else begin
      state_q   <= state_d;
      fetches_q <= PORT_LATENCY'({fetches_q, fetch_o});
      if (take) writes_q <= choose_aw;
      // A read holds its credit until the master has taken the answer, a write until it is answered.
      credits_q <= credits_q - CREDIT_BITS'(req_o) + CREDIT_BITS'(state_q == Read ? pop : rvalid_i);
    end
  end

  always_ff @(posedge clk_i) begin
    resp_q    <= resp_d;
    refused_q <= resp_i != RespOkay;
    if (take) begin
      id_q        <= taken.id;
      asks_q      <= taken.len;
      answers_q   <= taken.len;
      all_asked_q <= 1'b0;
    end else begin
      if (beat_done) begin
        asks_q      <= asks_q - 1'b1;
        all_asked_q <= asks_q == '0;
      end
      if (pop) answers_q <= answers_q - 1'b1;
    end
  end

  // ---- The channels to the master ----

  assign s_axi_bid = id_q;
  assign s_axi_bresp = resp_q;
  assign s_axi_bvalid = state_q == Respond;

  assign push = rvalid_i && (state_q == Read || fetched);

  pearl_fifo #(
      .WIDTH(DATA_WL + 2),
      .DEPTH(FIFO_DEPTH)
  ) u_answers (
      .clk_i,
      .rst_ni,
      .push_i (push),
      .data_i ({resp_i, rdata_i}),
      .valid_o(answer_valid),
      .data_o ({answer_resp, answer_data}),
      .pop_i  (pop)
  );

  assign pop = state_q == Merge || (s_axi_rvalid && s_axi_rready);
  assign s_axi_rid = id_q;
  assign s_axi_rdata = answer_data;
  assign s_axi_rresp = answer_resp;
  assign s_axi_rlast = answers_q == '0;
  assign s_axi_rvalid = state_q == Read && answer_valid;

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (32'(credits_q) != FIFO_DEPTH || !rvalid_i)
      else $error("pearl_axi_slave: an answer came that nobody asked for");
      assert (rvalid_i || !fetched)
      else $error("pearl_axi_slave: an answer did not come after PORT_LATENCY cycles");
      assert (credits_q != '0 || !req_o)
      else $error("pearl_axi_slave: a word was asked for that there was no room for");
    end
  end

endmodule
