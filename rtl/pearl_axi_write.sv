// SPDX-License-Identifier: MIT
// The writing half of an AXI4 slave: beats from W, at the addresses of the bursts from AW, become requests. When
// all requests of a burst have been answered, B says so; the next burst is written meanwhile.
//
// The memories behind take whole words only, and these stream at one a cycle. A beat that writes part of a word
// fetches the word first, and writes it back with that part changed in the cycle in which it comes; until then
// it holds the port. If the fetch was refused, nothing is written. A beat without strobes makes no request, but
// takes a turn all the same.
// It asks for a turn once it has both an address and a beat, so a master that keeps one of them back, or does
// not take answers, stops its own writes and no reads.
module pearl_axi_write
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

    input  logic                 aw_valid_i,
    output logic                 aw_ready_o,
    input  logic [  ID_BITS-1:0] aw_id_i,
    input  logic [ADDR_BITS-1:0] aw_addr_i,
    input  logic [          7:0] aw_len_i,
    input  logic [          2:0] aw_size_i,
    input  logic [          1:0] aw_burst_i,
    input  logic                 w_valid_i,
    output logic                 w_ready_o,
    input  logic [  DATA_WL-1:0] w_data_i,
    input  logic [STRB_BITS-1:0] w_strb_i,
    input  logic                 w_last_i,
    output logic                 b_valid_o,
    input  logic                 b_ready_i,
    output logic [  ID_BITS-1:0] b_id_o,
    output logic [          1:0] b_resp_o,

    // Wants a turn at the port, and has it in this cycle. From a fetch to the end of its write, it holds the port.
    output logic                       wants_o,
    input  logic                       grant_i,
    output logic                       holds_o,
    output logic                       req_o,
    output logic                       we_o,
    output logic                       fetch_o,
    output logic  [WORD_ADDR_BITS-1:0] addr_o,
    output logic  [       DATA_WL-1:0] wdata_o,
    // The answers to its requests.
    input  logic                       answer_i,
    input  logic  [       DATA_WL-1:0] data_i,
    input  resp_e                      resp_i
);

  typedef struct packed {
    logic last;
    // All bytes are written, or none.
    logic full;
    logic empty;
    logic [STRB_BITS-1:0] strb;
    logic [DATA_WL-1:0] data;
  } beat_t;

  beat_t w;
  logic beat_valid, w_valid, room, done, ends, unused_last;
  logic [ID_BITS-1:0] id;
  logic [ADDR_BITS-1:0] addr;
  // The master has placed the bytes, and counts on whole words.
  logic unused_addr;
  assign unused_addr = ^addr;

  pearl_slice #(
      .WIDTH($bits(beat_t))
  ) u_w (
      .clk_i,
      .rst_ni,
      .valid_i(w_valid_i),
      .ready_o(w_ready_o),
      .data_i ({w_last_i, &w_strb_i, w_strb_i == '0, w_strb_i, w_data_i}),
      .valid_o(w_valid),
      .ready_i(done),
      .data_o (w)
  );

  pearl_axi_address #(
      .ADDR_BITS(ADDR_BITS),
      .ID_BITS  (ID_BITS)
  ) u_address (
      .clk_i,
      .rst_ni,
      .valid_i(aw_valid_i),
      .ready_o(aw_ready_o),
      .id_i   (aw_id_i),
      .addr_i (aw_addr_i),
      .len_i  (aw_len_i),
      .size_i (aw_size_i),
      .burst_i(aw_burst_i),
      .valid_o(beat_valid),
      .id_o   (id),
      .addr_o (addr),
      // The beats say it themselves.
      .last_o (unused_last),
      .next_i (done),
      .end_i  (w.last)
  );

  // ---- Requests ----

  // Where in the port a fetch is, and where the last beats of bursts are, or would be if they made a request.
  logic [PORT_LATENCY-1:0] fetches_q, ends_q;
  logic fetching_q, fetched;

  assign fetched = fetches_q[PORT_LATENCY-1];
  assign wants_o = beat_valid && w_valid && room && !fetching_q;
  assign holds_o = fetching_q;
  assign done    = fetched || (grant_i && (w.full || w.empty));
  assign ends    = done && w.last;

  assign req_o   = fetched ? resp_i == RespOkay : grant_i && !w.empty;
  assign we_o    = fetched || w.full;
  assign fetch_o = grant_i && !w.full && !w.empty;
  assign addr_o  = addr[ADDR_BITS-1-:WORD_ADDR_BITS];
  for (genvar i = 0; i < STRB_BITS; i++) begin : gen_merge
    assign wdata_o[i*8+:8] = w.strb[i] ? w.data[i*8+:8] : data_i[i*8+:8];
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      fetches_q  <= '0;
      ends_q     <= '0;
      fetching_q <= 1'b0;
    end else begin
      fetches_q  <= PORT_LATENCY'({fetches_q, fetch_o});
      ends_q     <= PORT_LATENCY'({ends_q, ends});
      fetching_q <= fetch_o || (fetching_q && !fetched);
    end
  end

  // ---- Answers: the worst one of a burst's beats is the burst's ----

  logic [1:0] worst, worst_q;
  // The codes are such that the worse of two has all bits of both.
  assign worst = answer_i ? worst_q | resp_i : worst_q;

  always_ff @(posedge clk_i) begin
    if (!rst_ni || ends_q[PORT_LATENCY-1]) worst_q <= RespOkay;
    else worst_q <= worst;
  end

  pearl_axi_answers #(
      .NOTE_BITS  (ID_BITS),
      .ANSWER_BITS(2)
  ) u_answers (
      .clk_i,
      .rst_ni,
      .room_o  (room),
      .ask_i   (ends),
      .note_i  (id),
      .answer_i(ends_q[PORT_LATENCY-1]),
      .data_i  (worst),
      .valid_o (b_valid_o),
      .note_o  (b_id_o),
      .data_o  (b_resp_o),
      .take_i  (b_valid_o && b_ready_i)
  );

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (wants_o || !grant_i)
      else $error("pearl_axi_write: a turn was given that nobody wanted");
      assert (answer_i || !fetched)
      else $error("pearl_axi_write: a word that was fetched did not come after PORT_LATENCY cycles");
    end
  end

endmodule
