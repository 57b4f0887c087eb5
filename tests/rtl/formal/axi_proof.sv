// SPDX-License-Identifier: MIT
// pearl_axi_slave between any master that keeps to AXI4 and a memory port that answers anything, PORT_LATENCY
// cycles after it was asked. axi_properties.sv, bound to the slave, has the properties.
// Beside them: a read asks for as many words as it has beats, a write of part of a word changes that part of what
// the port granted, or nothing; and no burst stays where it is unless the master does not take or give a beat.
module axi_proof
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 16,
    parameter int unsigned ADDR_BITS = 4,
    localparam int unsigned ID_BITS = 2,
    localparam int unsigned STRB_BITS = DATA_WL / 8,
    localparam int unsigned WORD_ADDR_BITS = ADDR_BITS - $clog2(STRB_BITS)
) (
    input logic                 clk_i,
    input logic                 rst_ni,
    input logic [  ID_BITS-1:0] s_axi_awid,
    input logic [ADDR_BITS-1:0] s_axi_awaddr,
    input logic [          7:0] s_axi_awlen,
    input logic [          2:0] s_axi_awsize,
    input logic [          1:0] s_axi_awburst,
    input logic                 s_axi_awvalid,
    input logic [  DATA_WL-1:0] s_axi_wdata,
    input logic [STRB_BITS-1:0] s_axi_wstrb,
    input logic                 s_axi_wlast,
    input logic                 s_axi_wvalid,
    input logic                 s_axi_bready,
    input logic [  ID_BITS-1:0] s_axi_arid,
    input logic [ADDR_BITS-1:0] s_axi_araddr,
    input logic [          7:0] s_axi_arlen,
    input logic [          2:0] s_axi_arsize,
    input logic [          1:0] s_axi_arburst,
    input logic                 s_axi_arvalid,
    input logic                 s_axi_rready,
    input logic [  DATA_WL-1:0] rdata_i,
    input logic [          1:0] resp_i
);

  // Resets come at any time, and first of all.
  logic started_q = 1'b0;
  logic rst_n;
  assign rst_n = rst_ni && started_q;
  always_ff @(posedge clk_i) started_q <= 1'b1;

  logic req, we, fetch;
  logic [WORD_ADDR_BITS-1:0] addr;
  logic [  PORT_LATENCY-1:0] due_q;
  logic s_axi_awready, s_axi_wready, s_axi_bvalid, s_axi_arready, s_axi_rlast, s_axi_rvalid;
  logic [ID_BITS-1:0] s_axi_bid, s_axi_rid;
  logic [1:0] s_axi_bresp, s_axi_rresp;
  logic [DATA_WL-1:0] s_axi_rdata, wdata;

  always_ff @(posedge clk_i) begin
    if (!rst_n) due_q <= '0;
    else due_q <= PORT_LATENCY'({due_q, req});
  end

`ifdef PROPERTY_ONLY
  always_comb assume (rst_ni);
`endif
  always_comb assume (resp_i != 2'b01);

  pearl_axi_slave #(
      .DATA_WL  (DATA_WL),
      .ADDR_BITS(ADDR_BITS),
      .ID_BITS  (ID_BITS)
  ) u_slave (
      .rst_ni(rst_n),
      .req_o(req),
      .we_o(we),
      .fetch_o(fetch),
      .addr_o(addr),
      .wdata_o(wdata),
      .rvalid_i(due_q[PORT_LATENCY-1]),
      .rdata_i,
      .resp_i(resp_e'(resp_i)),
      .*
  );

  // ---- A write of part of a word ----

  // The port was asked for this word on behalf of a write, and whether it answered with it.
  logic fetching_q, fetched_q, granted_q;
  logic [WORD_ADDR_BITS-1:0] fetch_addr_q;
  logic [DATA_WL-1:0] word_q;
  logic [PORT_LATENCY-1:0] fetch_due_q;

  always_ff @(posedge clk_i) begin
    if (!rst_n) begin
      fetching_q  <= 1'b0;
      fetched_q   <= 1'b0;
      fetch_due_q <= '0;
    end else begin
      fetch_due_q <= PORT_LATENCY'({fetch_due_q, fetch});
      if (fetch) fetching_q <= 1'b1;
      fetched_q <= fetch_due_q[PORT_LATENCY-1];
      if (fetched_q) fetching_q <= 1'b0;
    end
    if (fetch) fetch_addr_q <= addr;
    granted_q <= resp_i == RespOkay;
    word_q <= rdata_i;
  end

  always_ff @(posedge clk_i) begin
    if (rst_n) begin
      if (fetch) fetch_reads : assert (req && !we);
      if (req && !we && !fetch) read_for_read : assert (!u_slave.writes_q);
      // Until the word is there nothing else is asked for; then it is written, or left alone.
      if (fetching_q && !fetched_q) fetch_alone : assert (!req);
      if (fetched_q) begin
        merge_granted : assert (req == granted_q);
        if (req) merge_writes : assert (we && addr == fetch_addr_q);
        for (int unsigned i = 0; i < STRB_BITS; i++) begin
          if (req && !u_slave.w.strb[i]) assert (wdata[i*8+:8] == word_q[i*8+:8]);
          if (req && u_slave.w.strb[i]) assert (wdata[i*8+:8] == u_slave.w.data[i*8+:8]);
        end
      end
      if (req && we && !fetched_q) whole_words : assert (&u_slave.w.strb && wdata == u_slave.w.data);
    end
  end

  // ---- A read ----

  // Words that were asked for since the last read ended.
  logic [8:0] asked_q;

  always_ff @(posedge clk_i) begin
    if (!rst_n || u_slave.u_properties.r_ends) asked_q <= '0;
    else asked_q <= asked_q + 9'(req && !we && !fetch);
    if (rst_n && u_slave.u_properties.r_ends) begin
      read_in_full : assert (asked_q == u_slave.u_properties.read_beats_q + 1'b1);
    end
  end

  // ---- An end ----

  // The states of the slave.
  localparam int unsigned IDLE = 0;
  localparam int unsigned BEGIN = 1;
  localparam int unsigned READ = 2;
  localparam int unsigned WRITE = 3;
  localparam int unsigned FETCH = 4;
  localparam int unsigned MERGE = 5;
  localparam int unsigned DRAIN = 6;
  localparam int unsigned RESPOND = 7;

  logic [2:0] state;
  assign state = 3'(u_slave.state_q);

  // How many cycles the slave needs at most until a beat moves, or a response is there.
  logic [31:0] first_due, last_due, needs;
  always_comb begin
    first_due = 0;
    last_due  = 0;
    for (int unsigned i = 0; i < PORT_LATENCY; i++) begin
      if (due_q[i]) first_due = PORT_LATENCY - i;
      if (due_q[PORT_LATENCY-1-i]) last_due = i + 1;
    end
    unique case (32'(state))
      BEGIN: needs = PORT_LATENCY + 2;
      READ: needs = s_axi_rvalid ? 0 : due_q == '0 ? PORT_LATENCY + 1 : first_due;
      WRITE: needs = PORT_LATENCY + 1;
      FETCH: needs = last_due;
      DRAIN: needs = last_due + 1;
      default: needs = 0;
    endcase
  end

  logic moves, hindered, stays_q, wrote_q, both_q;
  logic [31:0] needs_q;
  assign moves = state == 3'(IDLE) || u_slave.w_valid && u_slave.w_ready || u_slave.pop ||
                 s_axi_bvalid && s_axi_bready;
  assign hindered = state == 3'(WRITE) && !u_slave.w_valid || s_axi_rvalid && !s_axi_rready ||
                    s_axi_bvalid && !s_axi_bready;

  always_ff @(posedge clk_i) begin
    stays_q <= rst_n && !moves && !hindered;
    needs_q <= needs;
    // Both kinds waited; and this was the last one, or there was none.
    both_q  <= rst_n && state == 3'(IDLE) && u_slave.aw_valid && u_slave.ar_valid;
    if (u_slave.u_properties.b_moves || !rst_n) wrote_q <= 1'b1;
    else if (u_slave.u_properties.r_ends) wrote_q <= 1'b0;
    if (rst_n) begin
      if (stays_q) goes_on : assert (needs < needs_q);
      if (state == 3'(IDLE) && (u_slave.aw_valid || u_slave.ar_valid)) taken : assert (u_slave.take);
      if (both_q) in_turn : assert (u_slave.writes_q != wrote_q);
    end
  end

`ifndef PROPERTY_ONLY
  // ---- What makes it inductive ----

  localparam int unsigned DEPTH = 2 ** $clog2(PORT_LATENCY + 2);
  // Where an identity and a length are in what a slice holds, and whether a beat is the last one.
  localparam int unsigned LEN_AT = 5;
  localparam int unsigned ID_AT = LEN_AT + 8 + ADDR_BITS;
  localparam int unsigned LAST_AT = DATA_WL + STRB_BITS + 2;

  logic reading, writing, ending, ar_spare, aw_spare, w_spare;
  logic [31:0] under_way, waiting, used;
  assign reading = !u_slave.writes_q && state != IDLE;
  assign writing = u_slave.writes_q && state != IDLE;
  assign ending = state == DRAIN || state == RESPOND;
  assign ar_spare = u_slave.u_ar.valid_q && !u_slave.u_ar.ready_q;
  assign aw_spare = u_slave.u_aw.valid_q && !u_slave.u_aw.ready_q;
  assign w_spare = u_slave.u_w.valid_q && !u_slave.u_w.ready_q;
  assign under_way = 32'($countones(due_q));
  assign waiting = 32'(u_slave.u_answers.count);
  assign used = DEPTH - 32'(u_slave.credits_q);

  function automatic logic is_beat(logic [LAST_AT:0] beat);
    logic [STRB_BITS-1:0] strb;
    strb = beat[DATA_WL+:STRB_BITS];
    return beat[LAST_AT-1-:2] == {&strb, strb == '0};
  endfunction

  always_ff @(posedge clk_i) begin
    if (rst_n) begin
      assert (u_slave.u_properties.in_reset_q != u_slave.u_properties.awake_q);
      if (u_slave.u_properties.in_reset_q) begin
        assert (state == IDLE && !u_slave.u_aw.ready_q && !u_slave.u_w.ready_q && !u_slave.u_ar.ready_q);
        assert (!u_slave.u_aw.valid_q && !u_slave.u_w.valid_q && !u_slave.u_ar.valid_q);
      end else begin
        assert (u_slave.u_aw.ready_q || u_slave.u_aw.valid_q);
        assert (u_slave.u_w.ready_q || u_slave.u_w.valid_q);
        assert (u_slave.u_ar.ready_q || u_slave.u_ar.valid_q);
      end

      // Bursts are in the slices, but for the one under way.
      assert (32'(u_slave.u_properties.reads_q) == 32'(u_slave.ar_valid) + 32'(ar_spare) + 32'(reading));
      assert (32'(u_slave.u_properties.writes_q) == 32'(u_slave.aw_valid) + 32'(aw_spare) + 32'(writing));
      if (reading) assert (u_slave.id_q == u_slave.u_properties.read_ids_q[0]);
      if (u_slave.ar_valid) begin
        assert (u_slave.u_ar.data_q[ID_AT+:ID_BITS] == u_slave.u_properties.read_ids_q[32'(reading)]);
        assert (u_slave.u_ar.data_q[LEN_AT+:8] == u_slave.u_properties.read_lens_q[32'(reading)]);
      end
      if (ar_spare) begin
        assert (u_slave.u_ar.spare_q[ID_AT+:ID_BITS] == u_slave.u_properties.read_ids_q[32'(reading)+1]);
        assert (u_slave.u_ar.spare_q[LEN_AT+:8] == u_slave.u_properties.read_lens_q[32'(reading)+1]);
      end
      if (writing) assert (u_slave.id_q == u_slave.u_properties.write_ids_q[0]);
      if (u_slave.aw_valid)
        assert (u_slave.u_aw.data_q[ID_AT+:ID_BITS] == u_slave.u_properties.write_ids_q[32'(writing)]);
      if (aw_spare)
        assert (u_slave.u_aw.spare_q[ID_AT+:ID_BITS] == u_slave.u_properties.write_ids_q[32'(writing)+1]);

      // So are beats.
      assert (32'(u_slave.u_properties.datas_q) ==
              32'(u_slave.w_valid && u_slave.w.last) + 32'(w_spare && u_slave.u_w.spare_q[LAST_AT]) +
              32'(ending));
      if (u_slave.w_valid) assert (is_beat(u_slave.u_w.data_q));
      if (w_spare) assert (is_beat(u_slave.u_w.spare_q));
      if (state == IDLE) assert (wrote_q == u_slave.writes_q);
      assert (state != READ || reading);
      assert (state < WRITE || writing);

      // Of a read, what was asked for is under way or waits.
      assert (waiting <= DEPTH && used <= DEPTH);
      assert (used == under_way + (reading ? waiting : 0));
      assert (32'(asked_q) == (reading ? used + 32'(u_slave.u_properties.read_beats_q) : 0));
      if (reading) begin
        assert (32'(u_slave.answers_q) + 32'(u_slave.u_properties.read_beats_q) ==
                32'(u_slave.u_properties.read_lens_q[0]));
        if (u_slave.all_asked_q)
          assert (used == 32'(u_slave.answers_q) + 1);
          else assert (used + 32'(u_slave.asks_q) == 32'(u_slave.answers_q));
      end else begin
        assert (u_slave.u_properties.read_beats_q == '0);
        assert (waiting == 32'(state == MERGE));
      end
      if (state == BEGIN) assert (!u_slave.all_asked_q);
      if (state == IDLE || state == BEGIN || state == RESPOND) assert (used == 0);
      if (state != IDLE) assert (u_slave.resp_q != 2'b01);
      for (int unsigned i = 0; i < DEPTH; i++) begin
        if (i < waiting)
          assert (u_slave.u_answers.mem[$clog2(DEPTH)'(u_slave.u_answers.tail_q+i)][DATA_WL+:2] != 2'b01);
      end

      // A fetch is the last request that is under way.
      assert (fetch_due_q == u_slave.fetches_q);
      assert ((fetch_due_q & ~due_q) == '0 && (fetch_due_q & (fetch_due_q - 1'b1)) == '0);
      assert ((state == FETCH) == (fetch_due_q != '0));
      assert (fetched_q == (state == MERGE));
      assert (fetching_q == (state == FETCH || state == MERGE));
      if (fetching_q) begin
        assert (u_slave.w_valid && !u_slave.w.full && !u_slave.w.empty);
        assert (addr == fetch_addr_q);
      end
      if (fetched_q) assert (u_slave.answer_data == word_q && u_slave.refused_q != granted_q);
    end
  end
`endif

endmodule
